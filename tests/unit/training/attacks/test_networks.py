"""Attackers without a key win where something was planted, and gain nothing on noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
import torch
from scipy.stats import binom

from veilcam_training.attacks.intervals import Gain, accuracy_gain
from veilcam_training.attacks.keyless import FOLDS, cross_fit, dealt, presence_gain
from veilcam_training.attacks.networks import (
    TRIALS,
    Attacker,
    Build,
    Correlations,
    Seen,
    by_length,
    by_length_density,
    by_means,
    by_neighbours,
    by_network,
    convolutions,
    judged,
    linear,
    perceptron,
)
from veilcam_training.errors import TrainingError

SHAPE = (8, 8)
PIXELS = 64
MASKS = 480
BUILDS: dict[str, Build] = {
    "linear": linear,
    "perceptron": perceptron,
    "convolutions": partial(convolutions, SHAPE),
    "correlations": partial(Correlations, SHAPE),
}
LIGHT: dict[str, Attacker] = {
    "length": partial(by_length, bins=32),
    "density": partial(by_length_density, width=0.3),
    "means": by_means,
    "products": partial(by_neighbours, count=10, distances=False),
    "distances": partial(by_neighbours, count=10, distances=True),
}


@dataclass(frozen=True)
class Asked:
    """Captures (masks, captures of each, pixels), and their answers (masks, captures of each)."""

    vectors: torch.Tensor
    labels: torch.Tensor
    classes: int


def noise(classes: int, seed: int, captures: int = 1) -> Asked:
    """Directions that have nothing to do with the answers."""
    random = np.random.default_rng(seed)
    vectors = random.standard_normal((MASKS, captures, PIXELS)).astype(np.float32)
    vectors /= np.linalg.norm(vectors, axis=2, keepdims=True)
    labels = random.integers(classes, size=(MASKS, captures))
    return Asked(torch.from_numpy(vectors), torch.from_numpy(labels), classes)


def planted(classes: int, attacker: str, seed: int) -> Asked:
    """Noise, with a leak that this attacker is made for."""
    random, clean = np.random.default_rng(seed + 1), noise(classes, seed)
    marks = clean.labels.numpy()
    vectors = clean.vectors.double().numpy()
    if attacker in ("length", "density"):
        vectors = vectors * (1 + 0.1 * marks[..., None])
    elif attacker in LIGHT:
        hints = random.standard_normal((classes, PIXELS)) / np.sqrt(PIXELS)
        vectors = vectors + hints[marks]
    else:
        loud = np.ones((classes, PIXELS))
        for each, part in enumerate(np.array_split(np.arange(PIXELS), classes)):
            loud[each, part] = 3
        vectors = vectors * loud[marks]
    return replace(clean, vectors=torch.from_numpy(vectors.astype(np.float32)))


def gain(attacker: str, asked: Asked) -> Gain:
    scores, folds = cross_fit(LIGHT[attacker], asked.vectors, asked.labels, asked.classes, seed=1)
    if asked.classes == 2:
        return presence_gain(scores, asked.labels, folds)
    return accuracy_gain((scores.argmax(2) == asked.labels).numpy(), asked.classes)


@pytest.mark.slow
@pytest.mark.parametrize("classes", [2, 10])
@pytest.mark.parametrize("attacker", LIGHT)
def test_attacker_wins_on_a_leak_and_not_on_noise(attacker: str, classes: int) -> None:
    leaking = gain(attacker, planted(classes, attacker, 1))
    # Six standard errors: noise gives as much with a chance of 1e-9.
    assert leaking.value > max(leaking.bar, 6 * leaking.error)
    blind = gain(attacker, noise(classes, 1))
    # Of ten normal deviates one exceeds 3.5 with a chance of 0.5 %; the seeds are fixed.
    assert abs(blind.value) < 3.5 * blind.error


@pytest.mark.parametrize("build", BUILDS)
def test_network_wins_on_a_leak_and_not_on_noise(build: str) -> None:
    told: list[tuple[int, int]] = []

    def right(asked: Asked) -> int:
        seen = Seen(asked.vectors[:, 0], asked.labels[:, 0])
        learned, check, judging = (seen.take(part) for part in next(dealt(MASKS, 1)))
        attacker = partial(by_network, build=BUILDS[build], trial=TRIALS[1], epochs=12)
        scores = attacker(learned, check, 10, progress=lambda *each: told.append(each))
        return int((judged(scores, judging.vectors).argmax(1) == judging.labels).sum())

    # Whoever guesses among ten gets more right, of 120, with a chance of 1e-6.
    chance = binom(MASKS // FOLDS, 0.1)
    assert right(planted(10, build, 1)) > chance.isf(1e-6)
    assert chance.isf(1 - 1e-4) <= right(noise(10, 1)) <= chance.isf(1e-4)
    assert told[:12] == [(epoch, 12) for epoch in range(1, 13)]


def test_picture_has_as_many_pixels_as_its_shape_and_may_be_small() -> None:
    assert convolutions((3, 4), 12, 5)(torch.zeros(2, 2, 12)).shape == (2, 5)
    wide, narrow = (
        sum(p.numel() for p in convolutions((8, 8), 64, 5, width=width).parameters())
        for width in (32, 8)
    )
    assert wide > narrow
    with pytest.raises(TrainingError, match="no picture"):
        convolutions((3, 4), 13, 5)


def test_attacker_learns_from_one_capture_of_a_mask() -> None:
    asked = noise(10, 3, captures=2)
    asked.vectors[:, 1] *= 1 + asked.labels[:, 1, None]
    # The leak is in the second capture of each mask: nobody learns of it.
    found = gain("density", asked)
    assert found.value < 5


def test_every_mask_is_judged_once_by_whoever_never_learned_from_it() -> None:
    parts = list(dealt(50, 3))
    assert torch.cat([judging for *_, judging in parts]).sort().values.tolist() == list(range(50))
    for learned, check, judging in parts:
        assert torch.cat([learned, check, judging]).sort().values.tolist() == list(range(50))
        assert len(check) == round(0.2 * (50 - len(judging)))
    assert not torch.equal(parts[0][0], next(dealt(50, 4))[0])


def test_progress_is_told_of_every_fold() -> None:
    told: list[tuple[int, int]] = []
    asked = noise(10, 1)
    cross_fit(
        *(by_means, asked.vectors, asked.labels, 10),
        seed=1,
        progress=lambda *each: told.append(each),
    )
    assert told == [(fold, FOLDS) for fold in range(1, FOLDS + 1)]


def test_density_of_lengths_reads_and_unit_lengths_say_nothing() -> None:
    random = torch.Generator().manual_seed(0)
    labels = torch.randint(2, (2000,), generator=random)
    logs = labels + 0.5 * torch.randn(2000, generator=random)
    directions = torch.nn.functional.normalize(torch.randn(2000, PIXELS, generator=random))
    seen = Seen(directions * logs.exp()[:, None], labels)
    learned, asked = seen.take(torch.arange(1000)), seen.take(torch.arange(1000, 2000))
    scores = by_length_density(learned, asked, 2, width=0.2)
    right = int((judged(scores, asked.vectors).argmax(1) == asked.labels).sum())
    # Two normal laws two deviations apart: the best that there is reads 84 %.
    assert right > binom.isf(1 - 1e-4, 1000, 0.84) - 10
    unit = Seen(directions[:1000], labels[:1000])
    scores = by_length_density(unit, unit, 2, width=0.2)
    others = judged(scores, directions[1000:]).argmax(1)
    assert int((others == labels[1000:]).sum()) < binom.isf(1e-4, 1000, 0.5)
