"""Attackers who are to say whether two captures show the same: one scene, or one person.

Captures come in blocks of pairs: ``first`` and ``second`` (blocks, pairs, pixels); the i-th of
either show the same. Which masks they are behind is the caller's: every capture behind one of its
own, or a block behind one mask. Scores are (blocks, pairs, pairs), of each first with each second.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, cross_entropy, normalize

from veilcam_training.attacks.intervals import area
from veilcam_training.attacks.networks import (
    Build,
    Density,
    Family,
    Progress,
    Trial,
    inputs,
    linear,
    perceptron,
)
from veilcam_training.seeding import seeded

PAIRS = 10
"""Of a block."""

_OUTPUTS = 64
"""Of a metric network."""
_RIDGE = 1e-4
"""Beside a covariance of features that have variance 1."""

Blocks = tuple[Tensor, Tensor]
"""First and second captures."""
Link = Callable[[Tensor, Tensor], Tensor]
"""From first and second captures to scores."""


def blocks_of(vectors: Tensor, pairs: int = PAIRS) -> tuple[Tensor, Tensor]:
    """Blocks of captures (captures, pixels) of which neighbours show the same."""
    whole = len(vectors) // (2 * pairs) * 2 * pairs
    blocks = vectors[:whole].reshape(-1, pairs, 2, vectors.shape[1])
    return blocks[:, :, 0], blocks[:, :, 1]


def by_lengths(first: Tensor, second: Tensor) -> Tensor:
    """Return the likeness of two lengths."""
    one, other = (each.double().norm(dim=2) for each in (first, second))
    apart: Tensor = one[:, :, None] - other[:, None]
    return -apart.abs()


def by_known_lengths(learned: Blocks, *, width: float = 0.2) -> Link:
    """Likelihood ratio of two lengths, of one scene against of two: a rare length says more.

    Logarithms of two lengths of one scene differ normally; their density is that of the learned
    ones, by normal kernels.

    Args:
        learned: pairs behind masks of the attacker's own.
        width: width of a kernel, in deviations of the logarithms.
    """
    one, other = (_log_lengths(each).flatten() for each in learned)
    known = torch.cat([one, other])
    apart = (one - other).std().clamp_min(1e-30)
    unit = width * float(known.std().clamp_min(1e-30))
    density = Density(known, unit, torch.ones(len(known), 1))

    def link(first: Tensor, second: Tensor) -> Tensor:
        middle, between = _middles(first, second)
        rarity = -density(middle)[..., 0].clamp_min(1e-300).log()
        return rarity - (between / apart).square() / 2

    return link


def _log_lengths(vectors: Tensor) -> Tensor:
    lengths: Tensor = vectors.double().norm(dim=2).clamp_min(1e-30).log()
    return lengths


def _middles(first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and distance of the logarithms of lengths, of each first with each second."""
    left, right = _log_lengths(first)[:, :, None], _log_lengths(second)[:, None]
    return (left + right) / 2, (left - right).abs()


def by_products(first: Tensor, second: Tensor) -> Tensor:
    """Inner products."""
    return first.double() @ second.double().transpose(1, 2)


def by_cosines(first: Tensor, second: Tensor, *, mean: Tensor) -> Tensor:
    """Cosines, with what captures have in common taken out.

    Args:
        first: (blocks, pairs, pixels).
        second: likewise.
        mean: mean of captures, (pixels,).
    """
    apart = [each.double() - mean.double() for each in (first, second)]
    one, other = (each / each.norm(dim=2, keepdim=True).clamp_min(1e-300) for each in apart)
    cosines: Tensor = one @ other.transpose(1, 2)
    return cosines


def by_known_spread(learned: Blocks, *, ridge: float) -> Link:
    """Cosines, with what sets two captures of the same apart divided out.

    The covariance of differences between the two captures of a pair is whitened (within-class
    covariance normalisation, Hatch and others 2006): directions in which masks differ count less.

    Args:
        learned: pairs behind masks of the attacker's own.
        ridge: beside the covariance, in units of its mean variance.
    """
    one, other = (normalize(each.double().flatten(0, 1)) for each in learned)
    apart = one - other
    values, vectors = torch.linalg.eigh(apart.T @ apart / (2 * len(apart)))
    smallest = (ridge * values.mean()).clamp_min(1e-30)
    whitening = (vectors * (values.clamp_min(0) + smallest).rsqrt()) @ vectors.T

    def link(first: Tensor, second: Tensor) -> Tensor:
        left, right = (
            normalize(normalize(each.double(), dim=2) @ whitening, dim=2)
            for each in (first, second)
        )
        return left @ right.transpose(1, 2)

    return link


def by_known_angles(learned: Blocks) -> Link:
    """Fisher's discriminant of the angle between two vectors together with both of their lengths.

    Args:
        learned: pairs behind masks of the attacker's own; of its blocks all others are strangers.
    """
    known = _angles_and_lengths(*learned)
    features = (known - known.mean((0, 1, 2))) / known.std((0, 1, 2)).clamp_min(1e-12)
    own = torch.eye(known.shape[1], dtype=torch.bool)
    same, other = features[:, own].flatten(0, 1), features[:, ~own].flatten(0, 1)
    spread = torch.cov(same.T) + torch.cov(other.T) + _RIDGE * torch.eye(features.shape[3])
    direction = torch.linalg.solve(spread, same.mean(0) - other.mean(0))
    weights = direction / known.std((0, 1, 2)).clamp_min(1e-12)
    return lambda first, second: _angles_and_lengths(first, second) @ weights


def _angles_and_lengths(first: Tensor, second: Tensor) -> Tensor:
    """Compare each first with each second, (blocks, pairs, pairs, 9)."""
    middle, apart = _middles(first, second)
    product = by_products(first, second) / first.shape[2]
    cosine, between = product * (-2 * middle).exp(), product * (-middle).exp()
    lengths = [middle, middle.square(), apart, apart.square()]
    return torch.stack([*lengths, cosine, cosine.square(), cosine * middle, between, product], 3)


def by_distances(first: Tensor, second: Tensor) -> Tensor:
    """Return the likeness of two captures."""
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
    learned: Blocks,
    check: Blocks,
    *,
    trial: Trial,
    epochs: int,
    progress: Progress | None = None,
) -> Link:
    """Fit a network on pairs of same and of others; the best epoch on ``check`` counts."""
    first, second = learned
    scale = 1 / float(first.square().mean().sqrt())
    with seeded(trial.seed, "pairs"):
        network = _Pair(first.shape[2])

        def link(one: Tensor, other: Tensor) -> Tensor:
            return _all_pairs(network, scale * one, scale * other)

        def loss(part: Tensor) -> Tensor:
            return _loss(network, scale * first[part], scale * second[part])

        fit = _Fit(trial, epochs, progress)
        fit(network, link, loss, len(first), check)
    return link


def by_metric(
    learned: Blocks,
    check: Blocks,
    *,
    build: Build,
    trial: Trial,
    epochs: int,
    progress: Progress | None = None,
) -> Link:
    """Fit a network whose outputs are alike where captures show the same (two of one network).

    Its outputs have length 1; cosines, over a temperature of 0.1, are to tell the second of each
    first from its block (Sohn 2016, the N-pair loss). The best epoch on ``check`` counts.
    """
    first, second = learned
    scale = 1 / float(first.square().mean().sqrt())
    with seeded(trial.seed, "metric"):
        network = build(first.shape[2], _OUTPUTS)

        def map_(vectors: Tensor) -> Tensor:
            outputs: Tensor = network(inputs(vectors.flatten(0, 1), scale))
            return normalize(outputs).reshape(*vectors.shape[:2], _OUTPUTS)

        def link(one: Tensor, other: Tensor) -> Tensor:
            return map_(one) @ map_(other).transpose(1, 2)

        def loss(part: Tensor) -> Tensor:
            logits = link(first[part], second[part]) / 0.1
            own = torch.arange(first.shape[1]).expand(len(part), -1)
            return cross_entropy(logits, own) + cross_entropy(logits.mT, own)

        fit = _Fit(trial, epochs, progress)
        fit(network, link, loss, len(first), check)
    return link


@dataclass(frozen=True)
class _Fit:
    trial: Trial
    epochs: int
    progress: Progress | None

    def __call__(
        self,
        network: nn.Module,
        link: Link,
        loss: Callable[[Tensor], Tensor],
        count: int,
        check: Blocks,
    ) -> None:
        """Fit ``network`` to ``count`` blocks, of which ``loss`` takes some."""
        optimiser = torch.optim.AdamW(
            network.parameters(), self.trial.rate, weight_decay=self.trial.decay
        )
        best, kept = -1.0, network.state_dict()
        for epoch in range(self.epochs):
            network.train()
            for part in torch.split(torch.randperm(count), 16):
                optimiser.zero_grad()
                loss(part).backward()  # type: ignore[no-untyped-call]
                optimiser.step()
            network.eval()
            found = abs(link_area(link, *check) - 0.5)
            if found > best:
                best, kept = found, {k: v.clone() for k, v in network.state_dict().items()}
            if self.progress is not None:
                self.progress(epoch + 1, self.epochs)
        network.load_state_dict(kept)


def _loss(network: _Pair, first: Tensor, second: Tensor) -> Tensor:
    """Score every pair, and each first with the second of the pair beside it."""
    beside = second.roll(int(torch.randint(1, second.shape[1], ())), dims=1)
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
    learned: Blocks,
    check: Blocks,
    *,
    trials: tuple[Trial, ...],
    epochs: int,
) -> Link:
    """Choose the member of a family that links most of ``check``, whichever way round."""
    if family == "length":
        by_length: list[Link] = [by_lengths]
        by_length += [by_known_lengths(learned, width=width) for width in (0.1, 0.2, 0.4)]
        return max(by_length, key=lambda link: abs(link_area(link, *check) - 0.5))
    mean = torch.cat(learned).flatten(0, 1).mean(0)
    tried: list[Link] = [by_products, by_distances, partial(by_cosines, mean=mean)]
    tried += [by_known_spread(learned, ridge=ridge) for ridge in (1e-3, 1e-2, 1e-1)]
    tried.append(by_known_angles(learned))
    if family == "networks":
        tried = [by_network(learned, check, trial=trial, epochs=epochs) for trial in trials]
        tried += [
            by_metric(learned, check, build=build, trial=trial, epochs=epochs)
            for build in (linear, perceptron)
            for trial in trials[:1]
        ]
    return max(tried, key=lambda link: abs(link_area(link, *check) - 0.5))
