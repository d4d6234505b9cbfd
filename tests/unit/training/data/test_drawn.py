"""The pictures that come from a program: of five shapes, all different, the same for a seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from veilcam_training.data import open_source, recognise
from veilcam_training.data.drawn import SHAPES, draw_folder, draw_shape
from veilcam_training.data.summary import summarise
from veilcam_training.errors import TrainingError


def test_drawn_folder_is_a_data_set(tmp_path: Path) -> None:
    draw_folder(tmp_path / "a", 52, seed=1)
    assert recognise(tmp_path / "a") == "image-folder"
    source = open_source("image-folder", tmp_path / "a")
    assert source.labels == tuple(sorted(SHAPES))
    summary = summarise(source)
    assert (summary.training, summary.test, summary.warnings) == ((8,) * 5, (2,) * 5, ())
    draw_folder(tmp_path / "b", 52, seed=1)
    draw_folder(tmp_path / "c", 52, seed=2)
    same, other = (open_source("image-folder", tmp_path / name) for name in "bc")
    assert source.digests() == same.digests() != other.digests()


def test_shape_is_brighter_than_its_ground() -> None:
    random = np.random.default_rng(1)
    for name in SHAPES:
        pixels = np.asarray(draw_shape(name, random)).astype(float)
        # The shape reaches the middle, and no corner: 0.1 off centre, 0.22 of the side at least.
        middle = pixels[28:36, 28:36].max()
        corners = pixels[[0, 0, -1, -1], [0, -1, 0, -1]].max()
        assert middle > corners + 40


def test_folder_that_cannot_be_drawn_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="too few"):
        draw_folder(tmp_path / "a", 10, seed=1)
    (tmp_path / "x").write_text("kept")
    with pytest.raises(TrainingError, match="not empty"):
        draw_folder(tmp_path, 50, seed=1)
    assert (tmp_path / "x").read_text() == "kept"
