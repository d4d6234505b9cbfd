"""What stands beside a cell's accuracy, and what is done once."""

from __future__ import annotations

import json
from pathlib import Path
from unittest.mock import Mock

import pytest
from benchmarks.training.cells import CELLS, fitted, interval, times_of_reading

from veilcam_optics.camera.geometry import Embedding, Scene


def test_interval_is_students() -> None:
    # A deviation of 1 over the root of 3, times 4.303.
    assert interval([1.0, 2.0, 3.0]) == pytest.approx(2.4843, abs=1e-4)


def test_seed_that_is_done_is_not_done_again(tmp_path: Path) -> None:
    done = tmp_path / "1.json"
    done.write_text(json.dumps({"accuracy": 12.5, "minutes": 3.0}))
    cell = CELLS["mnist_hidden_3x4"]
    assert fitted(cell, Mock(side_effect=AssertionError), 1, done)["accuracy"] == 12.5


def test_reading_is_timed() -> None:
    found = times_of_reading(Scene(rows=8, columns=8), Embedding(4, 5), 10)
    assert all(value >= 0 for value in found.values())
    assert found.keys() == {"head_numpy_ms", "fresh_colour_prepare_s"}
