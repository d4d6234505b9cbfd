"""The mask of an epoch, found by gradient through the transfer operator from what left behind it.

An embedding is ``x T(w)``, and of all this the weights ``w`` alone are secret. Whoever knows some
pictures ``x``, or only how pictures are distributed, looks for the weights that explain best what
left. Each search starts at several random masks; the one that is taken is the one that explains the
captures best, so that no start is chosen by the truth.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol, Self

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Scene
from veilcam_optics.decoding import SceneDecoding
from veilcam_training.attacks.leaked import log_likelihoods
from veilcam_training.attacks.networks import Progress
from veilcam_training.errors import require

Likelihood = Callable[[Tensor], Tensor]
"""From weights to minus the logarithm of how likely they make what is known, up to a constant."""

MODEL_ERROR = 0.003
"""Relative error of the attacker's transfer operator, which leaves out what interferes far off."""


class Evidence(Protocol):
    """Evidence that an attacker has of one mask."""

    def near(self, weights: Tensor) -> Likelihood:
        """Return the likelihood, with the noise that there is if the mask is about ``weights``."""


@dataclass(frozen=True)
class KnownPictures:
    """Pictures that were before the camera, known or chosen, and the embeddings that left as read.

    Args:
        decoding: operator, statistics and noise, all public.
        scenes: (count, rows, columns).
        released: (count, E), in the same order.
    """

    decoding: SceneDecoding
    scenes: Tensor
    released: Tensor

    def near(self, weights: Tensor) -> Likelihood:
        """Return the evidence with normal errors of each number."""
        with torch.no_grad():
            measurements = self._measured(weights)
            noise = replace(self.decoding.noise, model_error=MODEL_ERROR)
            none = torch.zeros_like(measurements[0])
            variance = torch.stack([noise.variance(each, none) for each in measurements])

        def likelihood(weights: Tensor) -> Tensor:
            errors = self._measured(weights) - self.released
            total: Tensor = (errors.square() / variance + variance.log()).sum() / 2
            return total

        return likelihood

    def _measured(self, weights: Tensor) -> Tensor:
        return self.decoding.operator.embed(self.scenes, weights).flatten(1)


@dataclass(frozen=True)
class MeanCapture:
    """The mean of captures of unknown pictures, which left as they were read.

    Args:
        decoding: operator, statistics and noise, all public.
        mean: (E,).
        count: number of captures, pictures of which are drawn as the statistics say.
    """

    decoding: SceneDecoding
    mean: Tensor
    count: int

    def near(self, weights: Tensor) -> Likelihood:
        """Return the evidence of a mean of ``count`` pictures, with its covariance."""
        with torch.no_grad():
            mean, response, noise = _moments(self.decoding, weights)
            covariance = (response @ response.T + noise.diag()).double() / self.count
            covariance.diagonal().add_((MODEL_ERROR * mean.double()).square())
            factor = torch.linalg.cholesky(covariance)
            log_size = 2 * factor.diagonal().log().sum()
            precision = torch.cholesky_inverse(factor).float()
        scene = self.decoding.statistics.mean.reshape(1, *self.decoding.operator.scene.shape)

        def likelihood(weights: Tensor) -> Tensor:
            errors = self.decoding.operator.embed(scene, weights).flatten() - self.mean
            total: Tensor = (errors @ (precision @ errors) + log_size) / 2
            return total

        return likelihood


@dataclass(frozen=True)
class UnknownPictures:
    """Captures of unknown pictures, as they were read: mean and covariance at once.

    It is exact where pictures are normal, and slower than :class:`MeanCapture` by the product of
    transfer and covariance: a search is to start from what the mean found.

    Args:
        decoding: operator, statistics and noise, all public.
        released: (count, E).
    """

    decoding: SceneDecoding
    released: Tensor

    def near(self, weights: Tensor) -> Likelihood:
        """Return the likelihood itself: its noise follows the weights that it is asked for."""
        del weights
        return self._likelihood

    def _likelihood(self, weights: Tensor) -> Tensor:
        mean, response, noise = _moments(self.decoding, weights)
        return -log_likelihoods(self.released, mean, response, noise).sum()


def _moments(decoding: SceneDecoding, weights: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Mean (E,), response (E, rank) and variance of the noise (E,) of captures behind a mask."""
    statistics = decoding.statistics
    response = decoding.operator(weights).T
    mean, reduced = response @ statistics.mean, response @ statistics.basis
    lost = response.square() @ statistics.residual
    noise = replace(decoding.noise, model_error=MODEL_ERROR)
    spread = reduced.square().sum(1) + lost
    return mean, reduced, noise.variance(mean, spread) + lost


@dataclass(frozen=True)
class MaskPrior:
    """Prior of weights, each on its own: a mixture of normal laws.

    Attributes:
        shares: share of each law; their sum is 1.
        centres: centre of each law.
        deviations: deviation of each law.
    """

    shares: tuple[float, ...] = (1.0,)
    centres: tuple[float, ...] = (0.5,)
    deviations: tuple[float, ...] = (12**-0.5,)
    """Mean and deviation of weights that are uniform in [0, 1]."""

    @classmethod
    def of(cls, masks: Sequence[Tensor], least: float = 0.05) -> Self:
        """Return the prior of masks made as the camera's were, by their closed and open sub-pixels.

        Args:
            masks: the attacker's own.
            least: deviation of a law.
        """
        values = torch.cat([mask.flatten().float() for mask in masks])
        kinds = [part for part in (values[values < 0.5], values[values >= 0.5]) if len(part)]
        return cls(
            tuple(len(part) / len(values) for part in kinds),
            tuple(float(part.mean()) for part in kinds),
            tuple(max(least, float(part.std(correction=0))) for part in kinds),
        )

    def __call__(self, weights: Tensor) -> Tensor:
        """Minus the logarithm of the density, up to a constant."""
        laws = [
            math.log(share / deviation) - ((weights - centre) / deviation).square() / 2
            for share, centre, deviation in zip(
                self.shares, self.centres, self.deviations, strict=True
            )
        ]
        return -torch.logsumexp(torch.stack(laws), dim=0).sum()


UNIFORM = MaskPrior()


@dataclass(frozen=True)
class Search:
    """Search for weights: Adam on their logits, with a rate that falls as a cosine."""

    steps: int = 1000
    rate: float = 0.2
    starts: int = 2
    renewed: int = 100
    """After so many steps the likelihood takes the noise of the weights found so far."""


SEARCH = Search()


@dataclass(frozen=True)
class RecoveredMask:
    """Weights (``camera.mask_shape``), and minus the logarithm of how well they explain it all."""

    weights: Tensor
    loss: float


def recover_mask(
    evidence: Evidence,
    shape: tuple[int, int],
    *,
    prior: MaskPrior = UNIFORM,
    search: Search = SEARCH,
    start: Tensor | None = None,
    generator: torch.Generator,
    progress: Progress | None = None,
) -> RecoveredMask:
    """Return the mask that explains best what left behind it.

    Args:
        evidence: evidence about the mask.
        shape: ``camera.mask_shape``.
        prior: prior of masks.
        search: steps and starts.
        start: weights to start from, in place of random ones.
        generator: draws where to start.
        progress: called with starts done and to do.

    Returns:
        The best of all starts, by likelihood and prior alone.

    Raises:
        TrainingError: no start, or no step.
    """
    require(min(search.starts, search.steps) > 0, "a search without a step finds nothing: use 1")
    found = []
    for number in range(search.starts if start is None else 1):
        hidden = torch.randn(shape, generator=generator) / 2
        if start is not None:
            hidden = torch.logit(start.clamp(1e-3, 1 - 1e-3))
        weights = _descend(evidence, hidden, prior, search)
        with torch.no_grad():
            loss = evidence.near(weights)(weights) + prior(weights)
        found.append(RecoveredMask(weights, float(loss)))
        if progress is not None:
            progress(number + 1, search.starts if start is None else 1)
    return min(found, key=lambda mask: mask.loss)


def _descend(evidence: Evidence, hidden: Tensor, prior: MaskPrior, search: Search) -> Tensor:
    hidden.requires_grad_()
    optimiser = torch.optim.Adam([hidden], search.rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, search.steps)
    likelihood = evidence.near(torch.sigmoid(hidden.detach()))
    for step in range(search.steps):
        if step and step % search.renewed == 0:
            likelihood = evidence.near(torch.sigmoid(hidden.detach()))
        optimiser.zero_grad()
        weights = torch.sigmoid(hidden)
        (likelihood(weights) + prior(weights)).backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
    return torch.sigmoid(hidden.detach())


Choice = Literal["white", "points", "stripes"]


def chosen_pictures(choice: Choice, scene: Scene, count: int = 1) -> Tensor:
    """Pictures that an attacker would hold before the camera, (count, rows, columns).

    Args:
        choice: all white; one bright pixel each, spread evenly over the scene; or stripes, along
            rows and columns in turn, each pair twice as fine as the one before.
        scene: shape of the scene.
        count: number of points or stripes; there is one white picture.
    """
    rows, columns = scene.shape
    if choice == "white":
        return torch.ones(1, rows, columns)
    pictures = torch.zeros(count, rows, columns)
    if choice == "points":
        places = ((torch.arange(count) + 0.5) * rows * columns / count).long()
        pictures.flatten(1).scatter_(1, places[:, None], 1.0)
        return pictures
    for number, picture in enumerate(pictures):
        along = torch.arange(rows)[:, None] if number % 2 == 0 else torch.arange(columns)[None]
        length = rows if number % 2 == 0 else columns
        period = max(2, round(length / 2 ** (number // 2)))
        picture[:] = (along % period < period / 2).float()
    return pictures
