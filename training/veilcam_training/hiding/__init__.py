"""Hiding of masks, measured without a key: what an eye sees, a machine recognises and reads.

The daemon imports :mod:`.eye` and what lies below it, which need no torch.
"""
