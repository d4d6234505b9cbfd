"""Sealing: the device's key, and the receivers to whom it seals the keys of its epochs."""
