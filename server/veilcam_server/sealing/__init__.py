"""Who this device is, and to whom it seals the keys of its epochs."""
