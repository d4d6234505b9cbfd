"""Captures sorted by their mask without a key, and each group then read as one mask's."""

from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor

from veilcam_optics.decoding import SceneDecoding
from veilcam_training.attacks.clustering import adjusted_rand_index, k_means, subspace_clusters
from veilcam_training.attacks.leaked import log_likelihoods, read_behind
from veilcam_training.attacks.mask_recovery import (
    SEARCH,
    UNIFORM,
    MaskPrior,
    MeanCapture,
    Search,
    recover_mask,
)
from veilcam_training.attacks.networks import Progress
from veilcam_training.errors import require

Sorter = Callable[[Tensor, int, torch.Generator], Tensor]
"""From captures (count, E), a number of groups and random numbers to groups, int64 (count,)."""


def by_places(points: Tensor, clusters: int, generator: torch.Generator) -> Tensor:
    """k-means of captures as they are."""
    return k_means(points, clusters, generator)


def by_directions(points: Tensor, clusters: int, generator: torch.Generator) -> Tensor:
    """k-means of captures of length 1: the exposure does not count."""
    return k_means(_unit(points), clusters, generator)


def by_subspaces(points: Tensor, clusters: int, generator: torch.Generator) -> Tensor:
    """Return captures as combinations of one another."""
    return subspace_clusters(points, clusters, generator, neighbours=_neighbours(points))


def by_squares(points: Tensor, clusters: int, generator: torch.Generator) -> Tensor:
    """Return the same of their squares: a sign that changes does not count."""
    return subspace_clusters(points.square(), clusters, generator, neighbours=_neighbours(points))


def by_moments(
    points: Tensor, clusters: int, generator: torch.Generator, *, rank: int = 8, rounds: int = 10
) -> Tensor:
    """Find groups with a mean and a covariance each, in turns with their members.

    Classification EM (Celeux and Govaert 1992) from the groups of :func:`by_directions`. A
    covariance has the group's strongest components, and one variance for all that they leave.

    Args:
        points: (count, E).
        clusters: number of groups to make.
        generator: source of the random numbers.
        rank: components of a covariance.
        rounds: most turns.
    """
    groups = by_directions(points, clusters, generator)
    for _ in range(rounds):
        laws = [_law(points[groups == group], points, rank) for group in range(clusters)]
        likely = torch.stack([log_likelihoods(points, *law) for law in laws], dim=1)
        found = likely.argmax(1)
        if bool((found == groups).all()):
            break
        groups = found
    return groups


def _law(members: Tensor, points: Tensor, rank: int) -> tuple[Tensor, Tensor, Tensor]:
    """Mean, response and noise of a group; of all captures where it has too few of its own."""
    if len(members) < 2:
        members = points
    centred = members - members.mean(0)
    _, values, vectors = torch.linalg.svd(centred / len(members) ** 0.5, full_matrices=False)
    kept = min(rank, len(values) - 1)
    total = float(points.var(dim=0).sum())
    left = float(values[kept:].square().sum()) / points.shape[1]
    # No group is so sure of itself that none can leave it.
    noise = torch.full_like(points[0], max(left, 1e-4 * total / points.shape[1], 1e-30))
    return members.mean(0), vectors[:kept].T * values[:kept], noise


def _unit(points: Tensor) -> Tensor:
    unit: Tensor = points / points.norm(dim=1, keepdim=True).clamp_min(1e-30)
    return unit


def _neighbours(points: Tensor) -> int:
    return min(20, len(points) - 1)


SORTERS: Mapping[str, Sorter] = {
    "places": by_places,
    "directions": by_directions,
    "subspaces": by_subspaces,
    "squares": by_squares,
    "moments": by_moments,
}


def best_sorter(
    points: Tensor,
    masks: Tensor,
    generator: torch.Generator,
    sorters: Mapping[str, Sorter] = SORTERS,
) -> str:
    """Choose the sorter that sorts captures of an attacker's own masks best.

    Args:
        points: (count, E).
        masks: int64 (count,), the mask of each.
        generator: source of the random numbers.
        sorters: sorters by name.
    """
    count = len(set(masks.tolist()))

    def agreement(name: str) -> float:
        return adjusted_rand_index(masks, sorters[name](points, count, generator))

    return max(sorters, key=agreement)


def recover_groups(
    decoding: SceneDecoding,
    points: Tensor,
    groups: Tensor,
    *,
    prior: MaskPrior = UNIFORM,
    search: Search = SEARCH,
    generator: torch.Generator,
    progress: Progress | None = None,
) -> Sequence[Tensor]:
    """Return a mask for every group, from the mean of its captures: (groups, *camera.mask_shape).

    Args:
        decoding: public.
        points: captures as they were read, (count, E).
        groups: int64 (count,), from 0.
        prior: prior of masks.
        search: search for each mask.
        generator: draws where searches start.
        progress: called with groups done and to do.

    Raises:
        TrainingError: a group without a capture.
    """
    count = int(groups.max()) + 1
    found = []
    for group in range(count):
        members = points[groups == group]
        require(len(members) > 0, f"group {group} is empty: number groups without gaps")
        evidence = MeanCapture(decoding, members.mean(0), len(members))
        shape = decoding.operator.camera.mask_shape
        mask = recover_mask(evidence, shape, prior=prior, search=search, generator=generator)
        found.append(mask.weights)
        if progress is not None:
            progress(group + 1, count)
    return found


def read_groups(
    decoding: SceneDecoding, points: Tensor, groups: Tensor, masks: Sequence[Tensor]
) -> Tensor:
    """Decode every capture with its group's mask, (count, 2 x scene pixels)."""
    read = points.new_zeros(len(points), 2 * decoding.statistics.pixels)
    for group, weights in enumerate(masks):
        chosen = groups == group
        if bool(chosen.any()):
            read[chosen] = read_behind(decoding, weights, points[chosen])
    return read
