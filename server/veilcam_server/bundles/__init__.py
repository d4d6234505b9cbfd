"""Installed bundles, and the one in use."""
