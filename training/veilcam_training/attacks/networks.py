"""Attackers who are to answer a question about one released embedding, without any key.

Three families: by length, by inner products and distances, by trained networks. Each has several
members; which of them is used, and with which settings, is chosen on captures that were set apart
from those it learned from and from those it is judged by.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, Protocol

import numpy as np
import torch
from scipy.ndimage import gaussian_filter1d
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, one_hot
from torch.optim.lr_scheduler import OneCycleLR

from veilcam_training.errors import require
from veilcam_training.seeding import seeded

Family = Literal["length", "products", "networks"]
Scores = Callable[[Tensor], Tensor]
"""From vectors (count, pixels) to scores (count, classes)."""
_ROWS = 2048
"""Vectors that are judged at once."""
_GRID = 50
"""Points of a density's grid to a kernel's deviation: 1.2 % of its peak between two, at most."""


@dataclass(frozen=True)
class Seen:
    """Vectors (count, pixels) float32 and their answers (count,) int64."""

    vectors: Tensor
    labels: Tensor

    def take(self, chosen: Tensor) -> Seen:
        """Return some of the captures."""
        return Seen(self.vectors[chosen], self.labels[chosen])


class Attacker(Protocol):
    """Learns to answer."""

    def __call__(self, learned: Seen, check: Seen, classes: int) -> Scores:
        """Learn; ``check`` serves to stop in time, and to choose settings."""


def best_of(attackers: Sequence[Attacker]) -> Attacker:
    """Return the attacker that answers most of ``check`` right."""

    def attack(learned: Seen, check: Seen, classes: int) -> Scores:
        tried = [attacker(learned, check, classes) for attacker in attackers]
        return max(tried, key=lambda scores: _right(scores, check))

    return attack


def _right(scores: Scores, seen: Seen) -> float:
    return float((judged(scores, seen.vectors).argmax(1) == seen.labels).double().mean())


def judged(scores: Scores, vectors: Tensor) -> Tensor:
    """Scores of many vectors, (count, classes)."""
    with torch.no_grad():
        return torch.cat([scores(part) for part in torch.split(vectors, _ROWS)])


def by_length(learned: Seen, check: Seen, classes: int, *, bins: int) -> Scores:
    """Bayes' rule on a histogram of the lengths of vectors."""
    del check
    lengths = _length(learned.vectors)
    inner = torch.linspace(0, 1, bins + 1, dtype=torch.float64)[1:-1]
    edges = torch.quantile(lengths, inner)
    places = torch.bucketize(lengths, edges)
    counts = torch.ones(bins, classes, dtype=torch.float64)
    counts.index_put_((places, learned.labels), torch.ones_like(lengths), accumulate=True)
    table = (counts / counts.sum(0)).log()
    return lambda vectors: table[torch.bucketize(_length(vectors), edges)]


class Density:
    """Density of numbers of several kinds, by normal kernels (Parzen 1962) on a much finer grid.

    Args:
        values: (count,) float64.
        width: deviation of a kernel.
        kinds: share of each kind in a value, (count, kinds).
    """

    def __init__(self, values: Tensor, width: float, kinds: Tensor) -> None:
        self._step = width / _GRID
        margin = 4 * width
        self._least = float(values.min()) - margin
        size = int((float(values.max()) + margin - self._least) / self._step) + 2
        counts = torch.zeros(size, kinds.shape[1], dtype=torch.float64)
        counts.index_add_(0, self._places(values, size), kinds.double())
        smooth = gaussian_filter1d(counts.numpy(), _GRID, axis=0, mode="constant")
        self._table = torch.from_numpy(smooth)

    def __call__(self, values: Tensor) -> Tensor:
        """Up to a factor, (..., kinds); beyond the grid it is that of its end."""
        return self._table[self._places(values, len(self._table))]

    def _places(self, values: Tensor, size: int) -> Tensor:
        return ((values - self._least) / self._step).round().long().clamp(0, size - 1)


def by_length_density(learned: Seen, check: Seen, classes: int, *, width: float) -> Scores:
    """Bayes' rule on the density of lengths in each class, by normal kernels (Parzen 1962).

    Args:
        learned: captures whose lengths and answers are known.
        check: unused.
        classes: number of answers.
        width: width of a kernel on their logarithms, in deviations of all of these.
    """
    del check

    def logarithms(vectors: Tensor) -> Tensor:
        return _length(vectors).clamp_min(1e-30).log()

    lengths = logarithms(learned.vectors)
    unit = width * float(lengths.std().clamp_min(1e-30))
    density = Density(lengths, unit, one_hot(learned.labels, classes))
    return lambda vectors: density(logarithms(vectors))


def _length(vectors: Tensor) -> Tensor:
    lengths: Tensor = torch.linalg.vector_norm(vectors.double(), dim=1)
    return lengths


def by_means(learned: Seen, check: Seen, classes: int) -> Scores:
    """Inner products with the mean of each class."""
    del check
    members = one_hot(learned.labels, classes).float()
    means = (learned.vectors.T @ members) / members.sum(0).clamp_min(1)
    return lambda vectors: vectors @ means


def by_neighbours(
    learned: Seen, check: Seen, classes: int, *, count: int, distances: bool
) -> Scores:
    """Votes of the vectors that have the largest inner products, or are nearest."""
    del check
    votes = one_hot(learned.labels, classes).float()
    squares = learned.vectors.square().sum(1) / 2 if distances else 0.0
    near = min(count, len(votes))

    def scores(vectors: Tensor) -> Tensor:
        likeness = vectors @ learned.vectors.T - squares
        return votes[likeness.topk(near, dim=1).indices].sum(1)

    return scores


@dataclass(frozen=True)
class Trial:
    """One way to fit a network, with a seed of its own."""

    seed: int
    rate: float
    decay: float


TRIALS = (Trial(1, 1e-3, 1e-4), Trial(2, 3e-3, 1e-2), Trial(3, 3e-4, 1e-1))
_BATCH = 256

Build = Callable[[int, int], nn.Module]
"""From pixels and classes to a network of inputs (batch, 2, pixels): values and their squares."""


def linear(pixels: int, classes: int) -> nn.Module:
    """Logistic regression."""
    return nn.Sequential(nn.Flatten(), nn.Linear(2 * pixels, classes))


def perceptron(pixels: int, classes: int) -> nn.Module:
    """One hidden layer."""
    return nn.Sequential(
        nn.Flatten(),
        nn.Linear(2 * pixels, 256),
        nn.ReLU(),
        nn.Dropout(0.2),
        nn.Linear(256, classes),
    )


def check_shape(shape: tuple[int, int], pixels: int) -> tuple[int, int]:
    """``shape``, of a picture of so many pixels, or a TrainingError."""
    fits = shape[0] * shape[1] == pixels
    require(fits, f"{pixels} pixels are no picture of {shape}: use its size")
    return shape


def convolutions(
    shape: tuple[int, int], pixels: int, classes: int, *, width: int = 16
) -> nn.Module:
    """Two convolutions and two linear layers, on the embedding as a picture.

    Args:
        shape: rows and columns of the picture.
        pixels: their product.
        classes: answers to tell apart.
        width: channels of the first convolution; the second has twice as many.

    Raises:
        TrainingError: a shape of another size.
    """
    rows, columns = check_shape(shape, pixels)
    # Too short a side stays as long as it is.
    halved = [2 if side >= 4 else 1 for side in shape]
    left = (rows // halved[0] ** 2) * (columns // halved[1] ** 2)
    pool = (halved[0], halved[1])
    return nn.Sequential(
        nn.Unflatten(2, shape),
        *(nn.Conv2d(2, width, 3, padding=1), nn.ReLU(), nn.MaxPool2d(pool)),
        *(nn.Conv2d(width, 2 * width, 3, padding=1), nn.ReLU(), nn.MaxPool2d(pool)),
        *(nn.Flatten(), nn.Dropout(0.2), nn.Linear(2 * width * left, 128)),
        *(nn.ReLU(), nn.Linear(128, classes)),
    )


class Correlations(nn.Module):
    """Two hidden layers on a picture, its squares, its autocorrelation and its power spectrum.

    A scene convolved with a pattern that every mask draws anew has nearly its own autocorrelation,
    since such a pattern's is nearly a peak. Arguments and errors are those of :func:`convolutions`.
    """

    def __init__(self, shape: tuple[int, int], pixels: int, classes: int) -> None:
        super().__init__()
        rows, columns = self.shape = check_shape(shape, pixels)
        width = 2 * pixels + 2 * rows * (columns + 1) + rows * (columns // 2 + 1) + 1
        layers: list[nn.Module] = [nn.BatchNorm1d(width)]
        for before, after in pairwise((width, 512, 512)):
            layers += [nn.Linear(before, after), nn.BatchNorm1d(after), nn.ReLU(), nn.Dropout(0.1)]
        self.layers = nn.Sequential(*layers, nn.Linear(512, classes))

    def forward(self, seen: Tensor) -> Tensor:
        """Logits (batch, classes) of inputs (batch, 2, pixels)."""
        deviation, mean = torch.std_mean(seen[:, 0], dim=1, keepdim=True)
        picture = ((seen[:, 0] - mean) / deviation.clamp_min(1e-12)).reshape(-1, *self.shape)
        # Zeros around it, so that nothing meets its far end.
        padded = [2 * side for side in self.shape]
        power = torch.fft.rfft2(picture, s=padded).abs().square()
        lags = torch.fft.irfft2(power, s=padded)[..., : self.shape[1] + 1]
        waves = (torch.fft.rfft2(picture).abs().square() + 1e-3).log()
        told = (picture, picture.square(), lags, waves, deviation.clamp_min(1e-12).log())
        logits: Tensor = self.layers(torch.cat([each.flatten(1) for each in told], dim=1))
        return logits


Progress = Callable[[int, int], None]
"""Takes how much of how much is done."""


def by_network(
    learned: Seen,
    check: Seen,
    classes: int,
    *,
    build: Build,
    trial: Trial,
    epochs: int,
    progress: Progress | None = None,
) -> Scores:
    """Fit a network by AdamW, in one cycle (Smith 2018); its best epoch on ``check`` counts.

    Args:
        learned: captures and answers to learn from.
        check: captures that tell when to stop.
        classes: number of answers.
        build: makes the network.
        trial: seed and settings.
        epochs: most that it is fitted for.
        progress: called with epochs done and to do.
    """
    pixels = learned.vectors.shape[1]
    # One scale for all: what the length tells is kept.
    scale = 1 / float(learned.vectors.square().mean().sqrt())
    with seeded(trial.seed, "network"):
        network = build(pixels, classes)
        optimiser = torch.optim.AdamW(network.parameters(), trial.rate, weight_decay=trial.decay)
        batches = math.ceil(len(learned.labels) / _BATCH)
        schedule = OneCycleLR(optimiser, trial.rate, max(2, epochs * batches))
        best, kept = np.inf, network.state_dict()
        for epoch in range(epochs):
            network.train()
            for part in torch.randperm(len(learned.labels)).tensor_split(batches):
                batch = learned.take(part)
                optimiser.zero_grad()
                loss = cross_entropy(network(inputs(batch.vectors, scale)), batch.labels)
                loss.backward()  # type: ignore[no-untyped-call]
                optimiser.step()
                schedule.step()
            network.eval()
            logits = judged(lambda each: network(inputs(each, scale)), check.vectors)
            found = float(cross_entropy(logits, check.labels))
            if found < best:
                best, kept = found, {k: v.clone() for k, v in network.state_dict().items()}
            if progress is not None:
                progress(epoch + 1, epochs)
    network.load_state_dict(kept)
    return lambda vectors: network(inputs(vectors, scale))


def inputs(vectors: Tensor, scale: float) -> Tensor:
    """Return the inputs of networks: values over scale, and squares, (count, 2, pixels)."""
    values = vectors * scale
    return torch.stack([values, values.square() - 1], dim=1)
