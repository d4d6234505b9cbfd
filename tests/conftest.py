"""Settings that hold for every test."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

# Two OpenMP pools fighting over two cores run 10 to 80 times slower: set before torch is imported.
os.environ["OMP_NUM_THREADS"] = os.environ.get("VEILCAM_TEST_THREADS", "1")

import torch

THREADS = int(os.environ["OMP_NUM_THREADS"])
torch.set_num_threads(THREADS)

NUMERICAL = ("contracts", "optics", "training", "server/calibration", "server/devices")
"""Folders of tests that compute; single files elsewhere bear the mark themselves."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what ``make test-processors`` runs on several kinds of instructions."""
    folders = [Path(__file__).parent / folder for folder in NUMERICAL]
    for item in items:
        if any(item.path.is_relative_to(folder) for folder in folders):
            item.add_marker("numerical")


@pytest.fixture(autouse=True)
def number_of_threads() -> Iterator[None]:
    """Put back what a command sets for its whole process."""
    yield
    torch.set_num_threads(THREADS)
