"""Masks and epoch names from a key."""
