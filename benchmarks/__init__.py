"""Measurements by subject, one module each: ``python -m benchmarks.optics.step --help``."""

from __future__ import annotations

import os

# Before anything imports torch: OpenMP pools that fight over cores run 10 to 80 times slower.
os.environ.setdefault("OMP_NUM_THREADS", "1")
