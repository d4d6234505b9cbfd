"""Attackers on white embeddings win where something was planted, and gain nothing on noise."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.privacy.keys.released import Released
from benchmarks.privacy.keys.rows import attack
from benchmarks.privacy.keys.scenes import Question

from veilcam_optics.camera.geometry import Embedding
from veilcam_training.attacks.networks import Family

SHAPE = (8, 8)
PIXELS = Embedding(*SHAPE).size
MASKS = 480
CLASSES: dict[Question, int] = {"digit": 10, "presence": 2, "kind": 4, "linkage": 2}
FAMILIES: tuple[Family, ...] = ("length", "products", "networks")


def noise(question: Question, seed: int) -> Released:
    """Directions that have nothing to do with the answers."""
    random = np.random.default_rng(seed)
    captures = 2 if question == "kind" else 1
    vectors = random.standard_normal((MASKS, captures, PIXELS)).astype(np.float32)
    vectors /= np.linalg.norm(vectors, axis=2, keepdims=True)
    labels = random.integers(CLASSES[question], size=(MASKS, captures))
    return Released(vectors, labels, np.ones(labels.shape))


def planted(question: Question, family: Family, seed: int) -> Released:
    """Noise, with a leak that this family of attackers is made for."""
    random, clean = np.random.default_rng(seed + 1), noise(question, seed)
    marks = clean.labels
    if question == "linkage":
        # Neighbours saw the same scene.
        marks = np.repeat(random.integers(50, size=MASKS // 2), 2)[:, None]
    vectors = clean.vectors.astype(np.float64)
    if family == "length":
        vectors = vectors * (1 + 0.1 * marks[..., None])
    elif family == "products":
        hints = random.standard_normal((marks.max() + 1, PIXELS)) / np.sqrt(PIXELS)
        vectors = vectors + hints[marks]
    elif question == "linkage":
        # In size and not in sign: no inner product or distance sees it.
        loud = np.where(random.random((marks.max() + 1, PIXELS)) < 0.2, 10.0, 1.0)
        vectors = vectors * loud[marks]
    else:
        loud = np.ones((marks.max() + 1, PIXELS))
        for each, part in enumerate(np.array_split(np.arange(PIXELS), len(loud))):
            loud[each, part] = 3
        vectors = vectors * loud[marks]
    return Released(vectors.astype(np.float32), clean.labels, clean.lengths)


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("question", CLASSES)
def test_an_attacker_wins_on_a_leak_and_not_on_noise(question: Question, family: Family) -> None:
    leaking = attack(
        question,
        family,
        planted(question, family, 1),
        CLASSES[question],
        shape=SHAPE,
        epochs=15,
        seed=1,
    )
    # Six standard errors: noise gives as much with a chance of 1e-9.
    assert leaking.value > max(leaking.bar, 6 * leaking.error)
    blind = attack(
        question, family, noise(question, 1), CLASSES[question], shape=SHAPE, epochs=3, seed=1
    )
    # Of twelve normal deviates one exceeds 3.5 with a chance of 0.5 %; the seeds are fixed.
    assert abs(blind.value) < 3.5 * blind.error


def test_an_attacker_learns_from_one_capture_of_a_mask() -> None:
    released = noise("kind", 3)
    released.vectors[:, 1] *= 1 + released.labels[:, 1, None]
    # The leak is in the second capture of each mask: nobody learns of it.
    gain = attack("kind", "length", released, 4, shape=SHAPE, epochs=1, seed=1)
    assert gain.value < 5


def test_old_white_is_the_direction_times_its_length() -> None:
    released = noise("digit", 4)
    lengths = np.random.default_rng(4).random(released.labels.shape) + 1
    old = Released(released.vectors, released.labels, lengths).with_lengths()
    np.testing.assert_allclose(np.linalg.norm(old.vectors, axis=2), lengths, rtol=1e-6)
    with pytest.raises(ValueError, match="--legacy"):
        Released(released.vectors, released.labels, None).with_lengths()
