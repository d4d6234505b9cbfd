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

FINEST = Embedding(12, 16)
"""Pixels of a sensor that tell masks apart: more of them take more time, and tell no more."""
FLOOR = 1e-2
"""Singular values count from this share of the largest on: 40 dB, the noise of a measurement."""
DRAWN = 8
"""Random masks whose mean is what others are compared with."""


@dataclass(frozen=True, slots=True)
class Conditioning:
    """Of one mask, as shares of what masks drawn at random have in the same camera."""

    directions: float
    """Singular values of T above the floor, each of its columns less its mean."""
    spread: float
    """Participation ratio of the elements of what is the mask's own in T."""
    own: float
    """Energy of that: of T less what is proportional to T of an open window."""


class ConditioningMeter:
    """Measures masks of one camera.

    Args:
        camera: geometry.
        scene: before it.
        embedding: of it; a finer one than ``FINEST`` is measured as that.
    """

    def __init__(self, camera: Camera, scene: Scene, embedding: Embedding) -> None:
        rows, columns = min(embedding.rows, FINEST.rows), min(embedding.columns, FINEST.columns)
        self._transfer = TransferOperator(camera, scene, Embedding(rows, columns))
        generator = torch.Generator().manual_seed(0)
        with torch.inference_mode():
            self._open = self._transfer(torch.ones(camera.mask_shape)).double()
            drawn = [self._measure(random_mask(camera, generator)) for _ in range(DRAWN)]
        self._random = torch.stack(drawn).mean(0)

    def __call__(self, weights: Tensor) -> Conditioning:
        """Measure one mask.

        Args:
            weights: amplitude transmittances, ``camera.mask_shape``.

        Raises:
            OpticsError: the mask has another shape, or holds NaN or infinity.
        """
        with torch.inference_mode():
            return Conditioning(*(self._measure(weights) / self._random).tolist())

    def _measure(self, weights: Tensor) -> Tensor:
        """Number of singular values, participation ratio and share of energy: shape (3,)."""
        transfer = self._transfer(weights).double()
        light = transfer.square().sum()
        if light == 0:
            return torch.zeros(3, dtype=torch.float64)
        centred = transfer - transfer.mean(0, keepdim=True)
        # Squares of the singular values: a quarter of the time, and 1e-4 is far above rounding.
        squares = torch.linalg.eigvalsh(centred.T @ centred)
        directions = (squares > FLOOR**2 * squares[-1]).sum()
        share = (transfer * self._open).sum() / self._open.square().sum()
        own = (transfer - share * self._open).square()
        spread = own.sum().square() / own.square().sum().clamp_min(1e-300) / own.numel()
        return torch.stack((directions.double(), spread, own.sum() / light))
