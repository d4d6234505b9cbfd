"""Settings that hold for every test."""

from __future__ import annotations

import os

# Two OpenMP pools fighting over two cores run 10 to 80 times slower: set before torch is imported.
os.environ["OMP_NUM_THREADS"] = "1"

import torch

torch.set_num_threads(1)
