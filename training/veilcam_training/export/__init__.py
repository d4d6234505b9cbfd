"""Classifiers of a bundle as files that other software reads."""
