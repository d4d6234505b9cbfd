"""Conditioning of a mask's transfer matrix: whether the mask hides what is before it.

A mask that hides lays many shifted images of the scene over each other. Its transfer matrix then
carries many directions of a scene's space to the sensor, by an amount that only the mask tells; and
what it does to a scene pixel, other than an open window would, it does all over the sensor. Behind
one hole, the embedding is a picture. Behind an open window it is a picture that is out of focus,
which whoever knows the camera can put right.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.transfer.tables import make_transfer

Values = npt.NDArray[Any]

FINEST = Embedding(12, 16)
"""Pixels of a sensor that tell masks apart: more of them take more time, and tell no more."""
FLOOR = 1e-2
"""Singular values count from this share of the largest on: 40 dB, the noise of a measurement."""
DRAWN = 8
"""Random masks whose mean is what others are compared with."""


@dataclass(frozen=True, slots=True)
class Conditioning:
    """Conditioning of one mask, in shares of that of random masks in the same camera."""

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
        embedding: shape of the embedding; a finer one than ``FINEST`` is measured as that.
    """

    def __init__(self, camera: Camera, scene: Scene, embedding: Embedding) -> None:
        rows, columns = min(embedding.rows, FINEST.rows), min(embedding.columns, FINEST.columns)
        self._transfer = make_transfer(
            camera, scene, Embedding(rows, columns), like=np.empty(0, np.float32)
        )
        self._open = self._transfer(np.ones(camera.mask_shape, np.float32)).astype(np.float64)
        # The same ones always: what is refused stays refused.
        drawn = np.random.default_rng(0).random((DRAWN, *camera.mask_shape), np.float32)
        self._random = np.mean([self._measure(weights) for weights in drawn], axis=0)

    def __call__(self, weights: Values) -> Conditioning:
        """Measure one mask.

        Args:
            weights: amplitude transmittances, float32, ``camera.mask_shape``.

        Raises:
            OpticsError: the mask has another shape, or holds NaN or infinity.
        """
        return Conditioning(*(self._measure(weights) / self._random).tolist())

    def _measure(self, weights: Values) -> Values:
        """Return number of singular values, participation ratio and share of energy, (3,)."""
        transfer = self._transfer(weights).astype(np.float64)
        light = np.square(transfer).sum()
        if light == 0:
            return np.zeros(3)
        centred = transfer - transfer.mean(axis=0, keepdims=True)
        # Squares of the singular values: a quarter of the time, and 1e-4 is far above rounding.
        squares = np.linalg.eigvalsh(centred.T @ centred)
        directions = (squares > FLOOR**2 * squares[-1]).sum()
        share = (transfer * self._open).sum() / np.square(self._open).sum()
        own = np.square(transfer - share * self._open)
        spread = own.sum() ** 2 / max(np.square(own).sum(), 1e-300) / own.size
        return np.array((directions, spread, own.sum() / light))
