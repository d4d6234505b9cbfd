"""The mask of an epoch, found by gradient through the transfer operator from what left behind it.

An embedding is ``x T(w)``, and of all this the weights ``w`` alone are secret. Whoever knows some
pictures ``x``, or only how pictures are distributed, looks for the weights that explain best what
left. Each search starts at several random masks; the one that is taken is the one that explains the
captures best, so that no start is chosen by the truth.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import torch
from torch import Tensor

from veilcam_optics.decoding import SceneDecoding
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


def _moments(decoding: SceneDecoding, weights: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Mean (E,), response (E, rank) and variance of the noise (E,) of captures behind a mask."""
    statistics = decoding.statistics
    response = decoding.operator(weights).T
    mean, reduced = response @ statistics.mean, response @ statistics.basis
    lost = response.square() @ statistics.residual
    noise = replace(decoding.noise, model_error=MODEL_ERROR)
    spread = reduced.square().sum(1) + lost
    return mean, reduced, noise.variance(mean, spread) + lost


def _minus_log_prior(weights: Tensor) -> Tensor:
    """Minus the logarithm of a normal density with the mean and deviation of uniform weights."""
    return 6 * (weights - 0.5).square().sum()


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
    search: Search = SEARCH,
    generator: torch.Generator,
    progress: Progress | None = None,
) -> RecoveredMask:
    """Return the mask that explains best what left behind it.

    Args:
        evidence: evidence about the mask.
        shape: ``camera.mask_shape``.
        search: steps and starts.
        generator: draws where to start.
        progress: called with starts done and to do.

    Returns:
        The best of all starts, by likelihood and prior alone.

    Raises:
        TrainingError: no start, or no step.
    """
    require(min(search.starts, search.steps) > 0, "a search without a step finds nothing: use 1")
    found = []
    for number in range(search.starts):
        weights = _descend(evidence, torch.randn(shape, generator=generator) / 2, search)
        with torch.no_grad():
            loss = evidence.near(weights)(weights) + _minus_log_prior(weights)
        found.append(RecoveredMask(weights, float(loss)))
        if progress is not None:
            progress(number + 1, search.starts)
    return min(found, key=lambda mask: mask.loss)


def _descend(evidence: Evidence, hidden: Tensor, search: Search) -> Tensor:
    hidden.requires_grad_()
    optimiser = torch.optim.Adam([hidden], search.rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, search.steps)
    likelihood = evidence.near(torch.sigmoid(hidden.detach()))
    for step in range(search.steps):
        if step and step % search.renewed == 0:
            likelihood = evidence.near(torch.sigmoid(hidden.detach()))
        optimiser.zero_grad()
        weights = torch.sigmoid(hidden)
        (likelihood(weights) + _minus_log_prior(weights)).backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
    return torch.sigmoid(hidden.detach())


def estimates(decoding: SceneDecoding, weights: Tensor, measurements: Tensor) -> Tensor:
    """Return linear minimum-mean-square-error estimates of scenes behind a mask that was found.

    Args:
        decoding: operator, statistics and noise, all public.
        weights: ``camera.mask_shape``.
        measurements: (count, E).

    Returns:
        (count, rows, columns).
    """
    with torch.no_grad():
        return decoding.prepare(weights)(measurements)
