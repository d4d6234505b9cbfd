"""Groupings of points are found, and compared."""

from __future__ import annotations

import math

import pytest
import torch
from scipy.stats import chi2

from veilcam_training.attacks.clustering import (
    adjusted_rand_index,
    by_directions,
    k_means,
    subspace_clusters,
)
from veilcam_training.errors import TrainingError


def blobs(generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    labels = torch.arange(4).repeat_interleave(50)
    centres = 10 * torch.eye(4, 6)
    return centres[labels] + torch.randn(len(labels), 6, generator=generator), labels


def test_k_means_finds_blobs() -> None:
    generator = torch.Generator().manual_seed(0)
    points, labels = blobs(generator)
    assert adjusted_rand_index(labels, k_means(points, 4, generator)) == 1
    # By their directions they are found whatever their lengths are.
    points = points * torch.logspace(-2, 2, len(points))[torch.randperm(len(points)), None]
    assert adjusted_rand_index(labels, by_directions(points, 4, generator)) == 1
    same = torch.zeros(5, 3)
    assert len(k_means(same, 2, generator)) == 5
    with pytest.raises(TrainingError, match="clusters = 6"):
        k_means(same, 6, generator)


def test_subspaces_are_found_where_k_means_finds_none() -> None:
    generator = torch.Generator().manual_seed(0)
    bases = torch.linalg.qr(torch.randn(4, 30, 3, generator=generator))[0]
    points = torch.cat([torch.randn(60, 3, generator=generator) @ basis.T for basis in bases])
    labels = torch.arange(4).repeat_interleave(60)
    # Four times three dimensions fit into thirty without a line in common: what is said of a point
    # by others is said by its own subspace alone, and nothing is left to chance (Elhamifar and
    # Vidal 2013, theorem 1).
    assert adjusted_rand_index(labels, subspace_clusters(points, 4, generator)) == 1
    # A subspace lies on both sides of zero as one cluster of k-means does not: at best, each
    # is cut in two.
    halves = labels // 2 * 2 + torch.arange(len(labels)) % 2
    cut = adjusted_rand_index(labels, halves)
    assert adjusted_rand_index(labels, k_means(points, 4, generator)) <= cut < 0.5
    with pytest.raises(TrainingError, match="too few"):
        subspace_clusters(points[:10], 4, generator)


def test_adjusted_rand_index() -> None:
    one = torch.tensor([0, 0, 1, 1, 2, 2])
    assert adjusted_rand_index(one, (one + 1) % 3) == 1
    # Hubert and Arabie's formula by hand: 1 pair together in both, 3 and 4 in each, 15 in all.
    other = torch.tensor([0, 0, 0, 1, 1, 2])
    expected = 3 * 4 / 15
    assert adjusted_rand_index(one, other) == pytest.approx((1 - expected) / (3.5 - expected))
    generator = torch.Generator().manual_seed(0)
    one, other = torch.randint(5, (2, 2000), generator=generator)
    # Of groups of one size the index is (chi squared - 16) / (4 x 2000), where chi squared is that
    # of their 5 x 5 table: 57 and more once in a million times, and never less than 0. Sizes that
    # differ by chance, by a twentieth, change it by as much of itself.
    assert -16 / 8000 < adjusted_rand_index(one, other) * 0.9 < (chi2.isf(1e-6, 16) - 16) / 8000
    assert math.isclose(adjusted_rand_index(torch.zeros(4).long(), torch.zeros(4).long()), 1)
    with pytest.raises(TrainingError, match="groupings"):
        adjusted_rand_index(one, other[:3])
