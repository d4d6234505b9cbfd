"""Masks for the panel: drawn at random, and rounded to what the panel can show.

A mask is an array of weights, amplitude transmittances in [0, 1], of shape ``camera.mask_shape``.
What the panel is told are levels, whole numbers from 0 (opaque) to ``panel.levels - 1`` (open).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from veilcam_optics.arrays import Array, as_numpy, detached, namespace
from veilcam_optics.camera.geometry import Camera, Panel
from veilcam_optics.errors import OpticsError

if TYPE_CHECKING:
    import torch
    from torch import Tensor


def random_mask(camera: Camera, generator: torch.Generator) -> Tensor:
    """Independent uniform weights, float32, shape ``camera.mask_shape``."""
    import torch  # noqa: PLC0415 - a generator of torch is here, so torch is

    return torch.rand(camera.mask_shape, generator=generator)


def to_levels(weights: Array, panel: Panel) -> npt.NDArray[np.uint8]:
    """Round weights in [0, 1] to the panel's levels, uint8."""
    scaled = np.round(np.clip(as_numpy(weights), 0, 1) * (panel.levels - 1))
    levels: npt.NDArray[np.uint8] = scaled.astype(np.uint8)
    return levels


def to_weights(levels: npt.NDArray[np.uint8], panel: Panel) -> npt.NDArray[np.float32]:
    """Weights that a panel with a linear response shows for ``levels``, float32."""
    if levels.size and int(np.max(levels)) >= panel.levels:
        raise OpticsError(f"levels exceed what the panel can show: use 0 to {panel.levels - 1}")
    weights: npt.NDArray[np.float32] = levels.astype(np.float32) / np.float32(panel.levels - 1)
    return weights


def respond(weights: Array, *, gamma: float = 1.0, contrast_floor: float = 0.0) -> Array:
    """Amplitudes of a panel that is not linear, or not quite dark; same shape, differentiable.

    Args:
        weights: amplitudes asked of the panel, in [0, 1].
        gamma: the panel shows the power ``gamma`` of what it is told.
        contrast_floor: amplitude of a sub-pixel that is told to be dark.
    """
    xp = namespace(weights)
    if gamma != 1:
        # The slope at zero may be infinite, and a weight without a slope never opens again: it
        # is that of a small weight, while the amplitude is its own.
        nearby = (weights + detached(xp.clip(weights, 1e-6, None) - weights)) ** gamma
        weights = nearby + detached(xp.clip(weights, 0, None) ** gamma - nearby)
    if contrast_floor:
        weights = contrast_floor + (1 - contrast_floor) * weights
    return weights


def quantise(weights: Array, panel: Panel) -> Array:
    """Weights rounded to the panel's levels, with the gradient of the identity (straight-through).

    Rounding has a zero gradient almost everywhere; passing the gradient on unchanged lets training
    see the panel's real levels (Bengio, Leonard and Courville 2013).
    """
    steps = panel.levels - 1
    rounded = namespace(weights).round(weights * steps) / steps
    passed: Array = weights + detached(rounded - weights)
    return passed
