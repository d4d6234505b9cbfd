"""Masks are found where captures tell of them, and not where they are uniform directions."""

from __future__ import annotations

import pytest
import torch
from tests.unit.training.attacks.optics import (
    CAMERA,
    SCENE,
    hits,
    luck,
    make_decoding,
    make_victim,
    most,
    pictures,
)
from torch import Tensor

from veilcam_optics.decoding import SceneDecoding
from veilcam_training.attacks.leaked import read_behind
from veilcam_training.attacks.mask_recovery import (
    UNIFORM,
    Choice,
    Evidence,
    KnownPictures,
    MaskPrior,
    MeanCapture,
    Search,
    UnknownPictures,
    chosen_pictures,
    recover_mask,
)
from veilcam_training.attacks.victim import FORMS, ReleaseRule, raw
from veilcam_training.errors import TrainingError

SEARCH = Search(steps=200, starts=1)
COUNT = 400
"""Captures that are looked up with the mask that was found."""


@pytest.fixture(scope="module")
def decoding() -> SceneDecoding:
    """What is public."""
    return make_decoding()


def found(
    decoding: SceneDecoding,
    evidence: Evidence,
    *,
    start: Tensor | None = None,
    search: Search = SEARCH,
) -> Tensor:
    generator, shape = torch.Generator().manual_seed(5), decoding.operator.camera.mask_shape
    return recover_mask(evidence, shape, search=search, start=start, generator=generator).weights


def attacked(decoding: SceneDecoding, release: ReleaseRule, *, known: Tensor) -> int:
    """Hits among captures of one mask of which ``known`` pictures' captures are known."""
    victim = make_victim(decoding, release)
    mask = victim.mask()
    evidence = KnownPictures(decoding, known, victim.capture(mask, known))
    weights = found(decoding, evidence)
    scenes = pictures(COUNT, seed=3)
    return hits(read_behind(decoding, weights, victim.capture(mask, scenes)), scenes)


@pytest.mark.slow
def test_few_known_pictures_give_a_mask_away(decoding: SceneDecoding) -> None:
    assert attacked(decoding, raw, known=pictures(4, seed=2)) > most(COUNT)


@pytest.mark.slow
def test_known_pictures_tell_nothing_behind_a_rotation_of_its_own(decoding: SceneDecoding) -> None:
    known = pictures(4, seed=2)
    assert attacked(decoding, FORMS["white"], known=known) <= luck(COUNT)


@pytest.mark.slow
def test_chosen_pictures_give_a_mask_away(decoding: SceneDecoding) -> None:
    choices: tuple[Choice, ...] = ("points", "stripes")
    for choice in choices:
        known = chosen_pictures(choice, SCENE, 6)
        assert attacked(decoding, raw, known=known) > most(COUNT), choice


def test_chosen_pictures_are_what_they_say() -> None:
    assert bool((chosen_pictures("white", SCENE, 7) == torch.ones(1, 8, 8)).all())
    points = chosen_pictures("points", SCENE, 5)
    assert points.sum((1, 2)).tolist() == [1] * 5
    assert len(set(points.flatten(1).argmax(1).tolist())) == 5
    stripes = chosen_pictures("stripes", SCENE, 4)
    # Halves, then quarters, along rows and along columns.
    assert stripes.sum((1, 2)).tolist() == [32] * 4
    assert stripes[0, :, 0].tolist() == [1] * 4 + [0] * 4
    assert stripes[3, 0].tolist() == [1, 1, 0, 0] * 2


@pytest.mark.slow
def test_unknown_pictures_give_a_mask_away(decoding: SceneDecoding) -> None:
    victim = make_victim(decoding, raw)
    mask = victim.mask()
    released = victim.capture(mask, pictures(1000, seed=4))
    by_mean = found(decoding, MeanCapture(decoding, released.mean(0), len(released)))
    evidence = UnknownPictures(decoding, released)
    by_both = found(decoding, evidence, start=by_mean, search=Search(steps=60, rate=0.1, starts=1))
    scenes = pictures(COUNT, seed=3)
    measurements = victim.capture(mask, scenes)
    assert hits(read_behind(decoding, by_mean, measurements), scenes) > 3 * luck(COUNT)
    assert hits(read_behind(decoding, by_both, measurements), scenes) > most(COUNT)
    # The covariance says where the mean alone does not.
    likelihood = evidence.near(by_mean)
    assert float(likelihood(by_both)) < float(likelihood(by_mean))


@pytest.mark.slow
def test_the_mean_of_directions_tells_nothing(decoding: SceneDecoding) -> None:
    victim = make_victim(decoding, FORMS["white"])
    mask = victim.mask()
    released = victim.capture(mask, pictures(1000, seed=4))
    weights = found(decoding, MeanCapture(decoding, released.mean(0), len(released)))
    scenes = pictures(COUNT, seed=3)
    assert hits(read_behind(decoding, weights, victim.capture(mask, scenes)), scenes) <= luck(COUNT)


@pytest.mark.slow
def test_the_start_that_explains_most_is_taken(decoding: SceneDecoding) -> None:
    victim = make_victim(decoding, raw)
    mask = victim.mask()
    known = pictures(2, seed=2)
    evidence = KnownPictures(decoding, known, victim.capture(mask, known))
    generator = torch.Generator().manual_seed(5)
    said: list[tuple[int, int]] = []
    losses = [
        recover_mask(
            evidence,
            CAMERA.mask_shape,
            search=Search(steps=40, starts=1),
            generator=generator,
        ).loss
        for _ in range(3)
    ]
    best = recover_mask(
        evidence,
        CAMERA.mask_shape,
        search=Search(steps=40, starts=3),
        generator=torch.Generator().manual_seed(5),
        progress=lambda done, total: said.append((done, total)),
    )
    assert best.loss == min(losses) < max(losses)
    assert said == [(1, 3), (2, 3), (3, 3)]
    with pytest.raises(TrainingError, match="without a step"):
        recover_mask(evidence, CAMERA.mask_shape, search=Search(starts=0), generator=generator)


def test_a_prior_knows_closed_and_open_weights() -> None:
    mask = torch.tensor([[0.0, 0.0, 0.0, 0.9], [0.0, 0.0, 0.1, 1.0]])
    prior = MaskPrior.of([mask, mask])
    assert prior.shares == (0.75, 0.25)
    assert prior.centres == pytest.approx((0.1 / 6, 0.95))
    # Of the closed ones 0.037, of the open ones 0.05: neither may be surer than that.
    assert prior.deviations == pytest.approx((0.05, 0.05))
    assert float(prior(mask)) < float(prior(torch.full_like(mask, 0.5)))
    # Of one law only the square counts.
    assert float(UNIFORM(torch.tensor([[0.0]])) - UNIFORM(torch.tensor([[0.5]]))) == pytest.approx(
        0.25 * 12 / 2, rel=1e-5
    )
