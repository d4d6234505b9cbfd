"""Classifiers, and encoder and classifier in one module."""
