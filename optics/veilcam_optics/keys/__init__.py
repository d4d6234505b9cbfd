"""Masks from a key."""
