"""Doctor: needs of a Raspberry Pi that serves the camera, and how to meet them."""
