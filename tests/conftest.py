"""Settings that hold for every test."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

# Two OpenMP pools fighting over two cores run 10 to 80 times slower: set before torch is imported.
os.environ["OMP_NUM_THREADS"] = os.environ.get("VEILCAM_TEST_THREADS", "1")

import torch

THREADS = int(os.environ["OMP_NUM_THREADS"])
torch.set_num_threads(THREADS)


@pytest.fixture(autouse=True)
def number_of_threads() -> Iterator[None]:
    """Put back what a command sets for its whole process."""
    yield
    torch.set_num_threads(THREADS)
