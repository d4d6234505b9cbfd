"""Conditioning of a mask's transfer matrix: the mask tells more apart than a blur.

A mask that lays many shifted images of the scene over each other carries many directions of a
scene's space to the sensor. Behind an open window, stripes or one large hole, the embedding is a
picture out of focus, which whoever knows the camera can put right.
"""

from __future__ import annotations

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
            camera, scene, Embedding(rows, columns, embedding.fill), like=np.empty(0, np.float32)
        )
        # The same ones always: what is refused stays refused.
        drawn = np.random.default_rng(0).random((DRAWN, *camera.mask_shape), np.float32)
        self._random = float(np.mean([self._count(weights) for weights in drawn]))

    def directions(self, weights: Values) -> float:
        """Return a mask's number of directions, as a share of that of random masks.

        Directions are the singular values of T above the floor, its columns less their means.

        Args:
            weights: amplitude transmittances, float32, ``camera.mask_shape``.

        Raises:
            OpticsError: the mask has another shape, or holds NaN or infinity.
        """
        return self._count(weights) / self._random

    def _count(self, weights: Values) -> int:
        transfer = self._transfer(weights).astype(np.float64)
        if not transfer.any():
            return 0
        centred = transfer - transfer.mean(axis=0, keepdims=True)
        # Squares of the singular values: a quarter of the time, and 1e-4 is far above rounding.
        squares = np.linalg.eigvalsh(centred.T @ centred)
        return int((squares > FLOOR**2 * squares[-1]).sum())
