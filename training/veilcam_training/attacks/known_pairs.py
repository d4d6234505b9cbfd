"""Attackers who know what some captures of the current mask show.

Two things help them. What is known of the mask itself: similar captures show similar things (ridge
regression on kernels, neighbours, a network fitted to the few). And what is public: the attacker
puts the same known pictures behind masks of their own, and learns what the angles between a
capture and the known ones tell.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import torch
from torch import Tensor
from torch.nn.functional import one_hot

from veilcam_training.attacks.networks import (
    TRIALS,
    Attacker,
    Progress,
    Scores,
    Seen,
    Trial,
    best_of,
    by_network,
    linear,
    perceptron,
)

Reader = Callable[[Seen, Tensor, int], Tensor]
"""From known captures (n, pixels) and their classes, others (count, pixels) and the number of
classes to scores of the others, (count, classes)."""


@dataclass(frozen=True)
class Mask:
    """Captures of one mask: some that are known, and some that are to be read."""

    known: Seen
    asked: Seen

    def of_first(self, count: int) -> Mask:
        """Return the same pairs, of which less is known."""
        return Mask(self.known.take(torch.arange(count)), self.asked)


def directions(known: Tensor, vectors: Tensor) -> tuple[Tensor, Tensor]:
    """Both (count, pixels), less the mean of what is known and brought to length 1, float64.

    One known capture has no mean to take off.
    """
    mean = known.double().mean(0) if len(known) > 1 else torch.zeros_like(known[0]).double()
    apart = [each.double() - mean for each in (known, vectors)]
    one, other = (each / each.norm(dim=1, keepdim=True).clamp_min(1e-300) for each in apart)
    return one, other


@dataclass(frozen=True)
class KernelRidge:
    """Ridge regression of the classes on a kernel of directions.

    Attributes:
        kernel: ``linear``, ``quadratic`` (1 + cosine)^2 / 4, ``gaussian`` or ``laplace`` of the
            distance.
        ridge: beside the kernel's diagonal, which is 1.
        width: width of ``gaussian`` and ``laplace``, in distances of orthogonal directions.
    """

    kernel: Literal["linear", "quadratic", "gaussian", "laplace"]
    ridge: float
    width: float = 1.0

    def __call__(self, known: Seen, vectors: Tensor, classes: int) -> Tensor:
        """Scores (count, classes); see :data:`Reader`."""
        one, other = directions(known.vectors, vectors)
        matrix = self._of(one @ one.T)
        matrix.diagonal().add_(self.ridge)
        answers = one_hot(known.labels, classes).double() - 1 / classes
        scores: Tensor = self._of(other @ one.T) @ torch.linalg.solve(matrix, answers)
        return scores

    def _of(self, cosines: Tensor) -> Tensor:
        if self.kernel == "linear":
            return cosines
        if self.kernel == "quadratic":
            return (1 + cosines).square() / 4
        # In units of the distance of orthogonal directions, the square root of 2.
        squares = (1 - cosines).clamp_min(0) / self.width**2
        return (-squares if self.kernel == "gaussian" else -squares.sqrt()).exp()


@dataclass(frozen=True)
class Neighbours:
    """Votes of the known captures whose directions are nearest, weighted by their cosine."""

    count: int

    def __call__(self, known: Seen, vectors: Tensor, classes: int) -> Tensor:
        """Scores (count, classes); see :data:`Reader`."""
        one, other = directions(known.vectors, vectors)
        nearest = (other @ one.T).topk(min(self.count, len(one)), dim=1)
        votes = one_hot(known.labels, classes).double()[nearest.indices]
        return (votes * (1 + nearest.values)[..., None]).sum(1)


@dataclass(frozen=True)
class FewNetwork:
    """A perceptron fitted to the known captures alone.

    Attributes:
        decay: decay of the weights.
        epochs: number of epochs of the fit; nothing is set apart of what is little.
        seed: seed of the first weights.
    """

    decay: float
    epochs: int = 60
    seed: int = 1

    def __call__(self, known: Seen, vectors: Tensor, classes: int) -> Tensor:
        """Scores (count, classes); see :data:`Reader`."""
        one, other = (each.float() for each in directions(known.vectors, vectors))
        seen = Seen(one, known.labels)
        trial = Trial(self.seed, 3e-3, self.decay)
        scores = by_network(seen, seen, classes, build=perceptron, trial=trial, epochs=self.epochs)
        with torch.no_grad():
            return scores(other).double()


@dataclass(frozen=True)
class Anchored:
    """Reads by the angles to known captures, as learned behind masks of the attacker's own."""

    scores: Scores
    ridge: float

    def __call__(self, known: Seen, vectors: Tensor, classes: int) -> Tensor:
        """Scores (count, classes); see :data:`Reader`."""
        del classes
        with torch.no_grad():
            return self.scores(angles(known.vectors, vectors, self.ridge)).double()


def angles(known: Tensor, vectors: Tensor, ridge: float) -> Tensor:
    """Cosines of captures with known ones, freed of what the known have in common.

    Args:
        known: (n, pixels).
        vectors: (count, pixels).
        ridge: beside the diagonal, 1, of the known's cosines with one another, which are divided
            out: with 0 a known capture gives 1 at its own place and 0 elsewhere; infinite leaves
            the cosines as they are.

    Returns:
        float32 (count, n).
    """
    one, other = directions(known, vectors)
    cosines = other @ one.T
    if ridge < float("inf"):
        among = one @ one.T
        among.diagonal().add_(ridge)
        cosines = torch.linalg.solve(among, cosines, left=False)
    return cosines.float()


def by_anchors(
    own: Sequence[Mask], check: Sequence[Mask], classes: int, *, ridge: float, epochs: int
) -> Anchored:
    """Learn what angles to the known pictures tell.

    Args:
        own: captures behind masks of the attacker's own; known ones show the pictures that are
            known behind the mask under attack, in the same order.
        check: likewise, to stop in time and to choose settings by.
        classes: number of answers.
        ridge: ridge of :func:`angles`.
        epochs: most that a network is fitted for.
    """
    tried: list[Attacker] = [
        partial(by_network, build=build, trial=trial, epochs=epochs)
        for build, trial in ((linear, TRIALS[0]), (perceptron, TRIALS[0]), (perceptron, TRIALS[1]))
    ]
    scores = best_of(tried)(_seen(own, ridge), _seen(check, ridge), classes)
    return Anchored(scores, ridge)


def _seen(masks: Sequence[Mask], ridge: float) -> Seen:
    features = [angles(mask.known.vectors, mask.asked.vectors, ridge) for mask in masks]
    return Seen(torch.cat(features), torch.cat([mask.asked.labels for mask in masks]))


def readers() -> dict[str, Reader]:
    """Return the readers to try on the captures of one mask, by name."""
    found: dict[str, Reader] = {}
    for ridge in (1e-3, 1e-2, 1e-1, 1.0):
        for kernel in ("linear", "quadratic"):
            found[f"{kernel}, ridge {ridge:g}"] = KernelRidge(kernel, ridge)
        for width in (0.5, 1.0, 2.0):
            found[f"gaussian of {width:g}, ridge {ridge:g}"] = KernelRidge("gaussian", ridge, width)
        found[f"laplace, ridge {ridge:g}"] = KernelRidge("laplace", ridge)
    for count in (1, 5, 20):
        found[f"{count} neighbours"] = Neighbours(count)
    for decay in (1e-2, 1.0):
        found[f"network, decay {decay:g}"] = FewNetwork(decay)
    return found


def hits(reader: Reader, masks: Sequence[Mask], classes: int) -> Tensor:
    """Return whether each capture's class was found: bool (masks, captures)."""
    return torch.stack(
        [
            reader(mask.known, mask.asked.vectors, classes).argmax(1) == mask.asked.labels
            for mask in masks
        ]
    )


def tuned(
    tried: Mapping[str, Reader],
    check: Sequence[Mask],
    classes: int,
    *,
    progress: Progress | None = None,
) -> tuple[str, Reader]:
    """Return the reader that reads most behind masks of the attacker's own, and its name."""
    shares: dict[str, float] = {}
    for name, reader in tried.items():
        shares[name] = float(hits(reader, check, classes).double().mean())
        if progress is not None:
            progress(len(shares), len(tried))
    best = max(shares, key=shares.__getitem__)
    return best, tried[best]
