"""Conditioning of a mask's transfer matrix: whether the mask hides what is before it.

A mask that hides lays many shifted images of the scene over each other. Its transfer matrix then
carries many directions of a scene's space to the sensor, by an amount that only the mask tells; and
what it does to a scene pixel, other than an open window would, it does all over the sensor. Behind
one hole, the embedding is a picture. Behind an open window it is a picture that is out of focus,
which whoever knows the camera can put right.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.masks import random_mask
from veilcam_optics.transfer.operator import TransferOperator

BINNING = Embedding(12, 16)
"""What the sensor is binned to: whether a mask hides does not depend on the embedding."""
FLOOR = 1e-2
"""Singular values count from this share of the largest on: 40 dB, the noise of a measurement."""


@dataclass(frozen=True, slots=True)
class Conditioning:
    """Of one mask, as shares of what a mask drawn at random has in the same camera."""

    directions: float
    """Singular values of T above the floor, each of its columns less its mean."""
    spread: float
    """Participation ratio of the elements of T, less what is proportional to an open window's."""


class ConditioningMeter:
    """Measures masks of one camera.

    Args:
        camera: geometry.
        scene: before it.
    """

    def __init__(self, camera: Camera, scene: Scene) -> None:
        self._transfer = TransferOperator(camera, scene, BINNING)
        with torch.inference_mode():
            self._open = self._transfer(torch.ones(camera.mask_shape)).double()
            drawn = random_mask(camera, torch.Generator().manual_seed(0))
            self._random = self._measure(drawn)

    def __call__(self, weights: Tensor) -> Conditioning:
        """Measure one mask.

        Args:
            weights: amplitude transmittances, ``camera.mask_shape``.

        Raises:
            OpticsError: the mask has another shape, or holds NaN or infinity.
        """
        with torch.inference_mode():
            directions, spread = self._measure(weights)
        return Conditioning(directions / self._random[0], spread / self._random[1])

    def _measure(self, weights: Tensor) -> tuple[float, float]:
        transfer = self._transfer(weights).double()
        centred = transfer - transfer.mean(0, keepdim=True)
        # Squares of the singular values: a quarter of the time, and 1e-4 is far above rounding.
        squares = torch.linalg.eigvalsh(centred.T @ centred)
        directions = int((squares > FLOOR**2 * squares[-1]).sum()) if squares[-1] > 0 else 0
        share = (transfer * self._open).sum() / self._open.square().sum()
        energy = (transfer - share * self._open).square()
        # Less than a millionth is rounding.
        if energy.sum() <= 1e-6 * transfer.square().sum():
            return directions, 0.0
        return directions, float(energy.sum() ** 2 / energy.square().sum()) / energy.numel()
