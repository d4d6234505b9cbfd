"""What a Raspberry Pi needs to serve the camera: what is missing, and how to get it."""
