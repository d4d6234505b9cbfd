"""Simulated light: a model of a camera made to run."""
