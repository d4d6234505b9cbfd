"""Exact light in NumPy, which shares nothing with the product: what plans are held against."""
