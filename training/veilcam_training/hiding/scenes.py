"""Drawn scenes, masks and noise for the measurements of hiding, the same every time."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from veilcam_optics.camera.geometry import Camera, Scene

Values = npt.NDArray[Any]

GROUP = 100
"""Candidates that an attacker chooses from."""
RANDOM = 20
"""Random masks whose mean figure others are compared with."""
SNR = 10**4.0
"""Energy of a measurement over that of its noise: 40 dB."""
_GRAIN = 1 / 14
"""Standard deviation of a drawn scene's grain, in sides of the scene."""


def drawn_scenes(scene: Scene, channels: int, count: int) -> Values:
    """Return smooth random scenes, float32 (count, channels, rows, columns) in [0, 1]."""
    random = np.random.default_rng(1)
    values = random.standard_normal((count, channels, *scene.shape), np.float32)
    grain = _GRAIN * scene.rows
    values = smoother(scene.rows, grain) @ values @ smoother(scene.columns, grain).T
    values /= values.std(axis=(2, 3), keepdims=True)
    scenes: Values = np.clip(0.5 + 0.25 * values, 0, 1)
    return scenes


def smoother(size: int, sigma: float) -> Values:
    """Return the Gaussian mean along an axis of ``size`` as a matrix, its rows' sums 1."""
    places = np.arange(size)
    kernel = np.exp(-(((places[:, None] - places) / sigma) ** 2) / 2)
    matrix: Values = (kernel / kernel.sum(1, keepdims=True)).astype(np.float32)
    return matrix


def random_masks(camera: Camera, count: int = RANDOM) -> Values:
    """Return masks of uniform random weights, float32 (count, *mask shape)."""
    return np.random.default_rng(0).random((count, *camera.mask_shape), np.float32)


def noisy(measurements: Values) -> Values:
    """Return float32 measurements (count, pixels) with shot noise of 40 dB, the same every time."""
    lit = np.clip(measurements, 0, None)
    total = np.maximum(lit.sum(1, keepdims=True), np.finfo(np.float32).tiny)
    per_light = np.square(lit).sum(1, keepdims=True) / (total * SNR)
    result: Values = measurements + np.sqrt(lit * per_light) * _noise(lit.shape)
    return result.astype(np.float32, copy=False)


@lru_cache(maxsize=1)
def _noise(shape: tuple[int, ...]) -> Values:
    """Return normal numbers; they are drawn once for all masks of as many scenes."""
    noise: Values = np.random.default_rng(2).standard_normal(shape, np.float32)
    noise.flags.writeable = False
    return noise
