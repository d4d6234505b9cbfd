"""A simulated camera: emulated panel, fake sensor, scenes in front of them."""
