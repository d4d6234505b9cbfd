"""Attacks on released embeddings."""
