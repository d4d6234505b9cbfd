"""Experiments: fits from settings, bundles of them, and their provenance."""
