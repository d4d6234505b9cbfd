"""Attackers who are to say whether two captures, behind two masks, saw the same scene.

Captures come in blocks of pairs: ``first`` and ``second`` (blocks, pairs, pixels); the i-th of
either saw the same scene. Scores are (blocks, pairs, pairs), of each first with each second.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits

from veilcam_training.attacks.intervals import area
from veilcam_training.attacks.networks import Family, Trial

PAIRS = 10
"""Of a block."""

Link = Callable[[Tensor, Tensor], Tensor]


def blocks_of(vectors: Tensor) -> tuple[Tensor, Tensor]:
    """Blocks of captures (masks, pixels) of which neighbours saw the same scene."""
    whole = len(vectors) // (2 * PAIRS) * 2 * PAIRS
    pairs = vectors[:whole].reshape(-1, PAIRS, 2, vectors.shape[1])
    return pairs[:, :, 0], pairs[:, :, 1]


def by_lengths(first: Tensor, second: Tensor) -> Tensor:
    """How near their lengths are."""
    one, other = (each.double().norm(dim=2) for each in (first, second))
    apart: Tensor = one[:, :, None] - other[:, None]
    return -apart.abs()


def by_products(first: Tensor, second: Tensor) -> Tensor:
    """Inner products."""
    return first.double() @ second.double().transpose(1, 2)


def by_distances(first: Tensor, second: Tensor) -> Tensor:
    """How near they are."""
    distances: Tensor = torch.cdist(first.double(), second.double())
    return -distances


def link_area(link: Link, first: Tensor, second: Tensor) -> float:
    """Area under the curve over all pairs of all blocks."""
    with torch.no_grad():
        scores = link(first, second).double().numpy()
    same = np.broadcast_to(np.eye(scores.shape[1], dtype=bool), scores.shape)
    return area(scores.ravel(), same.ravel())[0]


class _Pair(nn.Module):
    """One hidden layer on products and differences of a pair, and on their lengths."""

    def __init__(self, pixels: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(2 * pixels + 2, 128), nn.ReLU(), nn.Dropout(0.2), nn.Linear(128, 1)
        )

    def forward(self, first: Tensor, second: Tensor) -> Tensor:
        """Logits (count,) of vectors (count, pixels)."""
        one, other = (each.norm(dim=1, keepdim=True) for each in (first, second))
        size = first.shape[1] ** 0.5
        lengths = torch.cat([(one - other).abs() / size, (one + other) / size - 2], dim=1)
        features = torch.cat([first * second, (first - second).square(), lengths], dim=1)
        logits: Tensor = self.layers(features)[:, 0]
        return logits


def by_network(
    learned: tuple[Tensor, Tensor], check: tuple[Tensor, Tensor], *, trial: Trial, epochs: int
) -> Link:
    """Fit a network on pairs of same and of other scenes; the best epoch on ``check`` counts."""
    first, second = learned
    scale = 1 / float(first.square().mean().sqrt())
    with torch.random.fork_rng():
        torch.manual_seed(trial.seed)
        network = _Pair(first.shape[2])

        def link(one: Tensor, other: Tensor) -> Tensor:
            return _all_pairs(network, scale * one, scale * other)

        optimiser = torch.optim.AdamW(network.parameters(), trial.rate, weight_decay=trial.decay)
        best, kept = -1.0, network.state_dict()
        for _ in range(epochs):
            network.train()
            for part in torch.split(torch.randperm(len(first)), 16):
                optimiser.zero_grad()
                loss = _loss(network, scale * first[part], scale * second[part])
                loss.backward()  # type: ignore[no-untyped-call]
                optimiser.step()
            network.eval()
            found = abs(link_area(link, *check) - 0.5)
            if found > best:
                best, kept = found, {k: v.clone() for k, v in network.state_dict().items()}
    network.load_state_dict(kept)
    return link


def _loss(network: _Pair, first: Tensor, second: Tensor) -> Tensor:
    """Of every pair, and of each first with the second of the pair beside it."""
    beside = second.roll(int(torch.randint(1, PAIRS, ())), dims=1)
    logits = network(first.flatten(0, 1).repeat(2, 1), torch.cat([second, beside]).flatten(0, 1))
    same = torch.arange(len(logits)) < len(logits) // 2
    return binary_cross_entropy_with_logits(logits, same.float())


def _all_pairs(network: _Pair, first: Tensor, second: Tensor) -> Tensor:
    blocks, pairs, _ = first.shape
    scores = []
    for one, other in zip(torch.split(first, 64), torch.split(second, 64), strict=True):
        left = one.repeat_interleave(pairs, dim=1).flatten(0, 1)
        right = other.repeat(1, pairs, 1).flatten(0, 1)
        scores.append(network(left, right))
    return torch.cat(scores).reshape(blocks, pairs, pairs)


def links(
    family: Family,
    learned: tuple[Tensor, Tensor],
    check: tuple[Tensor, Tensor],
    *,
    trials: tuple[Trial, ...],
    epochs: int,
) -> Link:
    """The member of a family that links most of ``check``, whichever way round."""
    if family == "length":
        return by_lengths
    tried: list[Link] = [by_products, by_distances]
    if family == "networks":
        tried = [by_network(learned, check, trial=trial, epochs=epochs) for trial in trials]
    return max(tried, key=lambda link: abs(link_area(link, *check) - 0.5))
