"""The sensor: noise, numbers and colours, after the optics."""
