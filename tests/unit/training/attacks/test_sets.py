"""Sets of captures of one mask tell what each alone does not, and nothing where nothing leaks."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from scipy.stats import binom
from tests.unit.training.attacks.test_known_pairs import random
from torch import Tensor

from veilcam_training.attacks.networks import TRIALS, by_means
from veilcam_training.attacks.sets import (
    VIEWS,
    SeenSets,
    View,
    as_read,
    by_average,
    by_sets,
    centred,
    decorrelated,
    gram,
    independent,
    moments,
)

PIXELS, CAPTURES, SETS = 12, 30, 160
CLASSES = 3


def labels(seed: int, sets: int = SETS) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(CLASSES, (sets, CAPTURES), generator=generator)


def leaking(view: View, seed: int) -> SeenSets:
    """Sets that tell the class in the way that a view shows."""
    answers, noise = labels(seed), random(SETS, CAPTURES, PIXELS, seed=seed + 1)
    turns = torch.linalg.qr(random(SETS, PIXELS, PIXELS, seed=seed + 2))[0]
    mean = 5 * random(SETS, 1, PIXELS, seed=seed + 3)
    level = (answers - 1)[..., None].float()
    if view is as_read:
        return SeenSets(noise + 2 * level, answers)
    if view is centred:  # behind what the captures of a set share
        return SeenSets(noise + 2 * level + mean, answers)
    if view is moments:  # of the whole set alone
        answers = answers[:, :1].expand(-1, CAPTURES)
        return SeenSets(noise * (1 + answers[..., None] * torch.eye(PIXELS)[0]), answers)
    # The loudest of the hidden numbers is the class's, skewed, and every mask mixes them anew.
    skewed = torch.tensor([-0.6, -0.4, 1.0])[answers]
    hidden = torch.cat([5 * skewed[..., None], noise[..., 1:]], dim=2)
    return SeenSets(hidden @ turns, answers)


def judge(attacker: object, seen: SeenSets, *, leaks: bool, whole: bool = False) -> None:
    """Of sets never seen, or no more than whoever guesses."""
    parts = [seen.take(part) for part in torch.split(torch.arange(SETS), [100, 20, 40])]
    scores = attacker(parts[0], parts[1], CLASSES)  # type: ignore[operator]
    with torch.no_grad():
        found = scores(parts[2].captures)
    answers = parts[2].labels
    if whole:
        found = found if found.ndim == 2 else found.log_softmax(2).sum(1)
        answers = answers[:, 0]
    right = int((found.argmax(-1) == answers).sum())
    chance = binom(answers.numel(), 1 / CLASSES)
    # Ten bounds: all hold with a chance of 99.9 % where nothing is told.
    if leaks:
        assert right > chance.isf(1e-6)
    else:
        assert chance.isf(1 - 1e-4) <= right <= chance.isf(1e-4)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "view",
    # Thirty captures unmix few components.
    [partial(view, components=3) if view is independent else view for view in VIEWS],
)
def test_network_reads_sets_in_the_view_that_shows_it(view: View) -> None:
    told: list[tuple[int, int]] = []
    attacker = partial(by_sets, view=view, trial=TRIALS[1], epochs=12)
    judge(
        partial(attacker, progress=lambda *each: told.append(each)),
        leaking(view, 10),
        leaks=True,
        whole=view is moments,
    )
    assert told == [(epoch, 12) for epoch in range(1, 13)]
    nothing = SeenSets(random(SETS, CAPTURES, PIXELS, seed=5), labels(6))
    judge(partial(by_sets, view=view, trial=TRIALS[1], epochs=2), nothing, leaks=False)


def test_average_of_a_still_scene_tells_what_one_capture_hides() -> None:
    answers = labels(1)[:, :1].expand(-1, CAPTURES)
    faint = 0.5 * random(CLASSES, PIXELS, seed=2)[answers]
    still = SeenSets(faint + random(SETS, CAPTURES, PIXELS, seed=3), answers)
    judge(partial(by_average, attacker=by_means), still, leaks=True, whole=True)
    nothing = SeenSets(random(SETS, CAPTURES, PIXELS, seed=4), answers)
    judge(partial(by_average, attacker=by_means), nothing, leaks=False, whole=True)


@pytest.mark.parametrize("view", VIEWS)
def test_view_follows_its_captures_in_whatever_order(view: View) -> None:
    sets = random(2, CAPTURES, PIXELS, seed=1).pow(3)
    order = torch.randperm(CAPTURES, generator=torch.Generator().manual_seed(2))
    # Sums in another order: some hundred roundings; an iteration of 50 steps adds them up.
    torch.testing.assert_close(view(sets[:, order]), view(sets)[:, order], rtol=1e-3, atol=1e-3)


def test_angles_do_not_change_under_a_rotation() -> None:
    sets = random(3, CAPTURES, PIXELS, seed=1)
    turn = torch.linalg.qr(random(3, PIXELS, PIXELS, seed=2))[0]
    torch.testing.assert_close(gram(sets @ turn), gram(sets), rtol=1e-4, atol=1e-5)
    assert gram(sets, neighbours=4).shape == (3, CAPTURES, 4)


def test_decorrelated_components_are_white_and_not_one_more() -> None:
    found = decorrelated(random(2, CAPTURES, PIXELS, seed=1), components=5).double()
    assert found.shape == (2, CAPTURES, 5)
    covariance = found.mT @ found / CAPTURES
    torch.testing.assert_close(
        covariance, torch.eye(5).double().expand(2, -1, -1), atol=1e-5, rtol=0
    )
    # Three captures differ in two directions: a third component is nothing, not noise.
    assert decorrelated(random(1, 3, PIXELS, seed=1))[0, :, 2].abs().max() == 0


def test_independent_components_are_unmixed() -> None:
    uniform = torch.rand(1, 2000, 3, generator=torch.Generator().manual_seed(1)) - 0.5
    mixed = uniform @ random(3, PIXELS, seed=2)
    found = independent(mixed, components=3)[0]
    likeness = torch.corrcoef(torch.cat([found, uniform[0]], dim=1).T)[:3, 3:].abs()
    # 2000 samples: unmixing errs by about 1 / sqrt(2000) = 0.02 in a coefficient.
    assert likeness.amax(0).min() > 0.98
    begun = independent(mixed, components=3, steps=0)[0]
    before = torch.corrcoef(torch.cat([begun, uniform[0]], dim=1).T)[:3, 3:].abs()
    assert before.amax(0).min() < 0.98


def test_moments_are_those_of_the_set() -> None:
    sets = random(2, CAPTURES, PIXELS, seed=1)
    found = moments(sets, eigenvalues=20)
    assert found.shape == (2, CAPTURES, 2 * PIXELS + 20)
    torch.testing.assert_close(found[:, 0, :PIXELS], as_read(sets).mean(1))
    assert (found[:, 0] == found[:, 1]).all()
    assert found[0, 0, -20:][PIXELS:].abs().max() == 0  # no more than there are pixels
