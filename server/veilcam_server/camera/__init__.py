"""The engine: one panel, one sensor, one lock."""
