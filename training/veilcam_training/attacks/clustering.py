"""Grouping embeddings without a key, as one would who wants to know which share a mask."""

import warnings
from operator import itemgetter

import numpy as np
import torch
from scipy.cluster import vq
from torch import Tensor

from veilcam_training.errors import require


def k_means(
    points: Tensor, clusters: int, generator: torch.Generator, *, restarts: int = 10
) -> Tensor:
    """Lloyd's algorithm from k-means++ seeds (Arthur and Vassilvitskii 2007), best of several.

    Args:
        points: (count, dimensions).
        clusters: number of groups to make.
        generator: source of the random numbers.
        restarts: number of new starts.

    Returns:
        int64 (count,): the group of each point, 0 to clusters - 1.

    Raises:
        TrainingError: fewer points than clusters.
    """
    require(
        1 <= clusters <= len(points), f"clusters = {clusters} is not valid: use 1 to {len(points)}"
    )
    values = points.double().cpu().numpy()
    random = np.random.default_rng(int(torch.randint(2**62, (), generator=generator)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # points that coincide fill fewer groups
        starts = [
            vq.kmeans2(values, clusters, iter=1, minit="++", rng=random)[0] for _ in range(restarts)
        ]
    centres, _ = min((vq.kmeans(values, start, thresh=0) for start in starts), key=itemgetter(1))
    groups, _ = vq.vq(values, centres)
    return torch.from_numpy(groups).long()


def by_directions(points: Tensor, clusters: int, generator: torch.Generator) -> Tensor:
    """Group points of length 1 by k-means: the exposure of a capture does not count."""
    unit = points / points.norm(dim=1, keepdim=True).clamp_min(1e-30)
    return k_means(unit, clusters, generator)


def subspace_clusters(
    points: Tensor,
    clusters: int,
    generator: torch.Generator,
    *,
    ridge: float = 0.1,
    neighbours: int = 20,
) -> Tensor:
    """Least-squares representation, then spectral clustering (Lu et al. 2012).

    Each point is written as a combination of all others; points of one subspace take part in one
    another's. The affinity keeps each point's largest coefficients.

    Args:
        points: (count, dimensions); they are scaled to length 1.
        clusters: number of groups to make.
        generator: source of the random numbers.
        ridge: penalty on the coefficients, relative to the points' length.
        neighbours: coefficients kept for each point.

    Returns:
        int64 (count,): the group of each point.

    Raises:
        TrainingError: fewer points than clusters or neighbours.
    """
    require(
        max(clusters, neighbours) < len(points),
        f"{len(points)} points are too few: use more than clusters, neighbours",
    )
    unit = points.double() / points.double().norm(dim=1, keepdim=True).clamp_min(1e-12)
    gram = unit @ unit.T
    identity = torch.eye(len(points), dtype=gram.dtype)
    inverse = torch.linalg.inv(gram + ridge * identity)
    # The best coefficients with none of a point for itself: -inverse_ij / inverse_jj.
    coefficients = (inverse / inverse.diagonal()).abs() * (1 - identity)
    kept = coefficients.topk(neighbours, dim=0)
    affinity = torch.zeros_like(gram).scatter_(0, kept.indices, kept.values)
    affinity = affinity + affinity.T
    root = affinity.sum(1).clamp_min(1e-12).rsqrt()
    _, vectors = torch.linalg.eigh(root[:, None] * affinity * root)
    coordinates = vectors[:, -clusters:]
    coordinates = coordinates / coordinates.norm(dim=1, keepdim=True).clamp_min(1e-12)
    return k_means(coordinates, clusters, generator)


def adjusted_rand_index(one: Tensor, other: Tensor) -> float:
    """Agreement of two groupings of the same points: 1 if they are the same, 0 by chance.

    Hubert and Arabie 1985, equation 5.

    Args:
        one: int64 (count,).
        other: int64 (count,).

    Raises:
        TrainingError: they differ in length, or are empty.
    """
    require(
        len(one) == len(other) > 0,
        f"groupings of {len(one)} and {len(other)} points: use the same",
    )
    pairs = int(one.max()) + 1, int(other.max()) + 1
    table = torch.bincount(one * pairs[1] + other, minlength=pairs[0] * pairs[1]).reshape(pairs)

    def choose(counts: Tensor) -> float:
        return float((counts.double() * (counts.double() - 1) / 2).sum())

    both, rows, columns = choose(table), choose(table.sum(1)), choose(table.sum(0))
    expected = rows * columns / choose(table.sum())
    most = (rows + columns) / 2
    return 1.0 if most == expected else (both - expected) / (most - expected)
