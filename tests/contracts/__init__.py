"""Contracts that every operator of the optics must keep, and the cases that break such code."""
