"""Faces beside digits: with the key they are told and matched, and from what leaves not."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.unit.training.attacks.card.conftest import SCENE, make_fresh, make_study

from veilcam_training.attacks.card.faces import face_notes, load_faces
from veilcam_training.errors import TrainingError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Faces of 60 persons: a person is two bars, which stand apart for one gender."""
    random = np.random.default_rng(1)
    identity = np.arange(60).repeat(12)
    gender = (identity % 2).astype(np.uint8)
    images = random.integers(0, 40, (len(identity), 64, 52)).astype(np.uint8)
    for picture, person, side in zip(images, identity, gender, strict=True):
        light = random.integers(150, 255)
        row, column = 8 + 6 * (person % 7), 8 + 5 * (person // 7 % 6)
        picture[row : row + 8, 4:48] = light
        picture[:, column : column + (16 if side else 5)] = light
    np.savez(tmp_path / "faces.npz", images=images, identity=identity, female=gender)
    return tmp_path


@pytest.mark.slow
def test_key_tells_faces_and_what_leaves_does_not(folder: Path) -> None:
    notes = face_notes(make_study(make_fresh()), load_faces(folder, SCENE))
    assert set(notes) == {"T8", "T9"}
    said = re.search(r"AUC ([\d.]+) from what leaves, ([\d.]+) with the key", notes["T8"])
    assert said is not None
    leaves, opened = map(float, said.groups())
    # 400 captures, an area's error is .029: four of them, and those of 20 pairs of masks.
    assert abs(leaves - 0.5) < 0.13
    assert opened > 0.8
    rates = re.findall(r"([\d.]+) % (?:of the|with)", notes["T9"])
    truth, key, wrong = map(float, rates)
    assert truth >= key > wrong
    assert wrong < 15


def test_faces_are_those_of_a_scene(folder: Path) -> None:
    faces = load_faces(folder, SCENE)
    assert faces.pixels.shape[1:] == SCENE.shape
    assert faces.groups is not None
    assert torch.unique(faces.groups).numel() > 40
    with pytest.raises(TrainingError, match="is not a folder"):
        load_faces(folder / "none", SCENE)
