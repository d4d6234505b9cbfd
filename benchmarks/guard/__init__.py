"""Figures of the guard: what opaque frames find, what they cost, and whom they accuse."""
