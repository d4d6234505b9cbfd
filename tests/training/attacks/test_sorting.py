"""Captures are sorted by mask and read where they tell of it, and not where they do not."""

from __future__ import annotations

import pytest
import torch
from scipy.stats import chi2
from tests.training.attacks.optics import (
    hits,
    luck,
    make_decoding,
    make_victim,
    pictures,
)
from torch import Tensor

from veilcam_optics.decoding import SceneDecoding
from veilcam_training.attacks.clustering import adjusted_rand_index
from veilcam_training.attacks.mask_recovery import Search
from veilcam_training.attacks.sorting import (
    SORTERS,
    best_sorter,
    by_directions,
    by_moments,
    read_groups,
    recover_groups,
)
from veilcam_training.attacks.victim import FORMS, ReleaseRule, StoredMasks, raw
from veilcam_training.errors import TrainingError

MASKS = 4
EACH = 100
EXPONENT, GROUND = 4.0, 0.7
"""Masks that differ, before a scene that is lit: a camera as small as this tells them apart."""


@pytest.fixture(scope="module")
def decoding() -> SceneDecoding:
    """What is public."""
    return make_decoding(ground=GROUND)


def captures(decoding: SceneDecoding, release: ReleaseRule, seed: int) -> tuple[Tensor, Tensor]:
    """Captures of ``MASKS`` stored masks, (count, E), and the place of each one's mask."""
    victim = make_victim(decoding, release, masks=MASKS, exponent=EXPONENT, seed=seed)
    assert isinstance(victim.source, StoredMasks)
    parts: list[Tensor] = []
    places: list[int] = []
    scenes = pictures(MASKS * EACH, seed=100 + seed, ground=GROUND)
    for start in range(0, len(scenes), EACH // 4):
        mask = victim.mask()
        parts.append(victim.capture(mask, scenes[start : start + EACH // 4]))
        places += [mask.place] * len(parts[-1])
    return torch.cat(parts), torch.tensor(places)


@pytest.mark.slow
def test_raw_captures_are_sorted_and_read(decoding: SceneDecoding) -> None:
    generator = torch.Generator().manual_seed(0)
    own, masks = captures(decoding, raw, seed=8)
    chosen = best_sorter(own, masks, generator)
    points, places = captures(decoding, raw, seed=9)
    groups = SORTERS[chosen](points, MASKS, generator)
    assert adjusted_rand_index(places, groups) > 0.8
    said: list[tuple[int, int]] = []
    found = recover_groups(
        decoding,
        points,
        groups,
        search=Search(steps=200, starts=1),
        generator=generator,
        progress=lambda done, total: said.append((done, total)),
    )
    assert said == [(number + 1, MASKS) for number in range(MASKS)]
    scenes = pictures(len(points), seed=109, ground=GROUND)
    assert hits(read_groups(decoding, points, groups, found), scenes) > 3 * luck(len(points))
    with pytest.raises(TrainingError, match="group 0 is empty"):
        recover_groups(decoding, points, groups + 1, generator=generator)


@pytest.mark.slow
def test_directions_are_not_sorted_and_not_read(decoding: SceneDecoding) -> None:
    victim = make_victim(decoding, FORMS["white"], masks=MASKS, seed=9)
    scenes = pictures(400, seed=31, ground=GROUND)
    masks = [victim.mask() for _ in scenes]
    points = torch.cat(
        [victim.capture(mask, scene[None]) for mask, scene in zip(masks, scenes, strict=True)]
    )
    places = torch.tensor([mask.place for mask in masks])
    generator = torch.Generator().manual_seed(0)
    # Of groupings into q groups that have nothing to do with each other, the index times n (q - 1)
    # is a chi square of (q - 1)^2 degrees less its mean; twice that for groups of unequal size.
    degrees = (MASKS - 1) ** 2
    bar = 2 * (chi2.isf(1e-4 / len(SORTERS), degrees) - degrees) / (len(points) * (MASKS - 1))
    for name, sorter in SORTERS.items():
        groups = sorter(points, MASKS, generator)
        assert adjusted_rand_index(places, groups) < bar, name
    groups = by_directions(points, MASKS, generator)
    search = Search(steps=100, starts=1)
    found = recover_groups(decoding, points, groups, search=search, generator=generator)
    assert hits(read_groups(decoding, points, groups, found), scenes) <= luck(len(points))


def test_groups_of_one_mean_are_told_apart_by_their_covariance() -> None:
    generator = torch.Generator().manual_seed(0)
    labels = torch.arange(2).repeat_interleave(300)
    points = 0.1 * torch.randn(600, 6, generator=generator)
    points[:300, :2] += torch.randn(300, 2, generator=generator)
    points[300:, 2:4] += torch.randn(300, 2, generator=generator)
    by_means = adjusted_rand_index(labels, by_directions(points, 2, generator))
    by_both = adjusted_rand_index(labels, by_moments(points, 2, generator, rank=2, rounds=30))
    assert by_means < 0.6
    assert by_both > 0.8
