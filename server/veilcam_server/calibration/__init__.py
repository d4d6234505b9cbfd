"""Calibration: measurements of panel, sensor and their distance with the camera itself."""
