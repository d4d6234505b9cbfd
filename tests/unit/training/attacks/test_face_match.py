"""The face-match score tells persons apart that it never saw, and strangers' noise not."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from veilcam_training.attacks.face_match import FaceMatch, fit_face_match
from veilcam_training.attacks.metrics import auc
from veilcam_training.errors import TrainingError


def persons(count: int, of_each: int, seed: int) -> tuple[Tensor, Tensor]:
    """Faces of a kind: a person is where its eyes and mouth are; light and place of all vary."""
    random = torch.Generator().manual_seed(seed)
    own = torch.rand(count, 5, generator=random)
    grid = torch.arange(16.0)
    pictures, names = [], []
    for name, (eyes, apart, mouth, wide, nose) in enumerate(own):
        for _ in range(of_each):
            light, shift = torch.rand(2, generator=random)
            spots = (
                (3 + 3 * eyes, 7.5 - 1 - 4 * apart, 1.0),
                (3 + 3 * eyes, 7.5 + 1 + 4 * apart, 1.0),
                (11 + 3 * mouth, torch.tensor(7.5), 1 + 3 * wide),
                (7 + 2 * nose, torch.tensor(7.5), 1.0),
            )
            face = torch.zeros(16, 16)
            for row, column, width in spots:
                y = torch.exp(-((grid - row - shift) ** 2))
                face += y[:, None] * torch.exp(-((grid - column) ** 2) / width**2)
            pictures.append((0.5 + 0.5 * light) * face.clamp(0, 1))
            names.append(name)
    return torch.stack(pictures), torch.tensor(names)


@pytest.fixture(scope="module")
def match() -> FaceMatch:
    return fit_face_match(*persons(50, 6, 1), epochs=6, seed=1)


@pytest.mark.slow
def test_strangers_are_told_apart_and_the_same_person_is_found(match: FaceMatch) -> None:
    pictures, _ = persons(40, 2, 2)
    one, other = pictures[::2], pictures[1::2]
    same = match(one, other)
    strangers = match(one, other.roll(1, 0))
    scores = torch.cat([same, strangers])
    # Whoever says nothing of persons is at one half with this error (Mann and Whitney 1947), and
    # five of them above it once in three million times.
    error = math.sqrt((40 + 40 + 1) / (12 * 40 * 40))
    assert auc(scores, torch.arange(80) < 40) > 0.5 + 5 * error
    assert match(one, one) == pytest.approx(torch.ones(40), abs=1e-5)


@pytest.mark.slow
def test_noise_matches_nobody(match: FaceMatch) -> None:
    pictures, _ = persons(100, 1, 3)
    noise = torch.rand(200, 16, 16, generator=torch.Generator().manual_seed(4))
    scores = match(noise, pictures.repeat(2, 1, 1))
    # What is called the same is drawn by chance: an area of 100 and 100 has an error of .041.
    assert abs(auc(scores, torch.arange(200) < 100) - 0.5) < 4 * 0.041


def test_faces_without_differences_are_refused() -> None:
    pictures, names = persons(2, 2, 1)
    with pytest.raises(TrainingError, match="one person alone"):
        fit_face_match(pictures, torch.zeros_like(names), epochs=1, seed=1)
    with pytest.raises(TrainingError, match="too small"):
        fit_face_match(pictures[:, :4], names, epochs=1, seed=1)
