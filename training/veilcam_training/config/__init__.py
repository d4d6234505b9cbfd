"""Settings of a fit, and recipes by name."""
