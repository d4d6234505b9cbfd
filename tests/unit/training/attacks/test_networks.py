"""Attackers without a key win where something was planted, and gain nothing on noise."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from scipy.stats import binom

from veilcam_training.attacks.intervals import Gain, holm
from veilcam_training.attacks.keyless import FOLDS, Asked, Kind, dealt, gain, worst_upper
from veilcam_training.attacks.networks import (
    FAMILIES,
    TRIALS,
    Build,
    Correlations,
    Family,
    Seen,
    attackers,
    by_length_density,
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
CLASSES: dict[Kind, int] = {"class": 10, "presence": 2, "linkage": 2}
BUILDS: dict[str, Build] = {
    "linear": linear,
    "perceptron": perceptron,
    "convolutions": partial(convolutions, SHAPE),
    "correlations": partial(Correlations, SHAPE),
}


def noise(kind: Kind, seed: int, captures: int = 1) -> Asked:
    """Directions that have nothing to do with the answers."""
    random = np.random.default_rng(seed)
    vectors = random.standard_normal((MASKS, captures, PIXELS)).astype(np.float32)
    vectors /= np.linalg.norm(vectors, axis=2, keepdims=True)
    labels = random.integers(CLASSES[kind], size=(MASKS, captures))
    return Asked(kind, torch.from_numpy(vectors), torch.from_numpy(labels), CLASSES[kind], SHAPE)


def planted(kind: Kind, family: Family, seed: int) -> Asked:
    """Noise, with a leak that this family of attackers is made for."""
    random, clean = np.random.default_rng(seed + 1), noise(kind, seed)
    marks = clean.labels.numpy()
    if kind == "linkage":
        # Neighbours saw the same scene.
        marks = np.repeat(random.integers(50, size=MASKS // 2), 2)[:, None]
    vectors = clean.vectors.double().numpy()
    if family == "length":
        vectors = vectors * (1 + 0.1 * marks[..., None])
    elif family == "products":
        hints = random.standard_normal((marks.max() + 1, PIXELS)) / np.sqrt(PIXELS)
        vectors = vectors + hints[marks]
    elif kind == "linkage":
        # In size and not in sign: no inner product or distance sees it.
        loud = np.where(random.random((marks.max() + 1, PIXELS)) < 0.2, 10.0, 1.0)
        vectors = vectors * loud[marks]
    else:
        loud = np.ones((marks.max() + 1, PIXELS))
        for each, part in enumerate(np.array_split(np.arange(PIXELS), len(loud))):
            loud[each, part] = 3
        vectors = vectors * loud[marks]
    return replace(clean, vectors=torch.from_numpy(vectors.astype(np.float32)))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("kind", "family"),
    # A network and ten classes: below, and in less time.
    [(k, f) for k in CLASSES for f in FAMILIES if (k, f) != ("class", "networks")],
)
def test_attacker_wins_on_a_leak_and_not_on_noise(kind: Kind, family: Family) -> None:
    leaking = gain(planted(kind, family, 1), family, epochs=5, seed=1)
    # Six standard errors: noise gives as much with a chance of 1e-9.
    assert leaking.value > max(leaking.bar, 6 * leaking.error)
    blind = gain(noise(kind, 1), family, epochs=1, seed=1)
    # Of eight normal deviates one exceeds 3.5 with a chance of 0.4 %; the seeds are fixed.
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
    assert right(planted("class", "networks", 1)) > chance.isf(1e-6)
    assert chance.isf(1 - 1e-4) <= right(noise("class", 1)) <= chance.isf(1e-4)
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
    # What is no picture is shown to no convolutions.
    assert len(attackers("networks", None, 1)) < len(attackers("networks", SHAPE, 1))


def test_attacker_learns_from_one_capture_of_a_mask() -> None:
    asked = noise("class", 3, captures=2)
    asked.vectors[:, 1] *= 1 + asked.labels[:, 1, None]
    # The leak is in the second capture of each mask: nobody learns of it.
    found = gain(asked, "length", epochs=1, seed=1)
    assert found.value < 5


def test_every_mask_is_judged_once_by_whoever_never_learned_from_it() -> None:
    parts = list(dealt(50, 3))
    assert torch.cat([judging for *_, judging in parts]).sort().values.tolist() == list(range(50))
    for learned, check, judging in parts:
        assert torch.cat([learned, check, judging]).sort().values.tolist() == list(range(50))
        assert len(check) == round(0.2 * (50 - len(judging)))
    assert not torch.equal(parts[0][0], next(dealt(50, 4))[0])


def test_worst_upper_end_is_that_of_the_row_nearest_to_its_bar() -> None:
    verdicts = holm(
        {"a": Gain(0.4, 0.01, 1.0, 100, 10.4), "b": Gain(0.015, 0.0001, 0.02, 100, 0.515)}
    )
    assert worst_upper(verdicts) == pytest.approx(verdicts["b"].upper / 0.02)
    assert 0.75 < worst_upper(verdicts) < 1


def test_progress_is_told_of_every_fold() -> None:
    told: list[tuple[int, int]] = []
    kinds: tuple[Kind, ...] = ("class", "linkage")
    for kind in kinds:
        tell = lambda *each: told.append(each)  # noqa: E731
        assert gain(noise(kind, 1), "products", epochs=1, seed=1, progress=tell).count > 0
    assert told == 2 * [(fold, FOLDS) for fold in range(1, FOLDS + 1)]


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
