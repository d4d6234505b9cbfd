"""Masks for the panel: drawn at random, and rounded to what the panel can show.

A mask is a tensor of weights, amplitude transmittances in [0, 1], of shape ``camera.mask_shape``.
What the panel is told are levels, whole numbers from 0 (opaque) to ``panel.levels - 1`` (open).
"""

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Panel
from veilcam_optics.errors import OpticsError


def random_mask(camera: Camera, generator: torch.Generator) -> Tensor:
    """Independent uniform weights, float32, shape ``camera.mask_shape``."""
    return torch.rand(camera.mask_shape, generator=generator)


def to_levels(weights: Tensor, panel: Panel) -> npt.NDArray[np.uint8]:
    """Round weights in [0, 1] to the panel's levels, uint8."""
    scaled = (weights.detach().cpu().clamp(0, 1) * (panel.levels - 1)).round()
    return scaled.to(torch.uint8).numpy()


def to_weights(levels: npt.NDArray[np.uint8], panel: Panel) -> Tensor:
    """Weights that a panel with a linear response shows for ``levels``, float32."""
    if levels.size and int(levels.max()) >= panel.levels:
        raise OpticsError(f"levels exceed what the panel can show: use 0 to {panel.levels - 1}")
    return torch.from_numpy(levels.astype(np.float32)) / (panel.levels - 1)


def respond(weights: Tensor, *, gamma: float = 1.0, contrast_floor: float = 0.0) -> Tensor:
    """Amplitudes of a panel that is not linear, or not quite dark; same shape, differentiable.

    Args:
        weights: amplitudes asked of the panel, in [0, 1].
        gamma: the panel shows the power ``gamma`` of what it is told.
        contrast_floor: amplitude of a sub-pixel that is told to be dark.
    """
    if gamma != 1:
        # The slope at zero may be infinite, and a weight without a slope never opens again: it
        # is that of a small weight, while the amplitude is its own.
        nearby = (weights + (weights.clamp_min(1e-6) - weights).detach()) ** gamma
        weights = nearby + (weights.clamp_min(0) ** gamma - nearby).detach()
    if contrast_floor:
        weights = contrast_floor + (1 - contrast_floor) * weights
    return weights


def quantise(weights: Tensor, panel: Panel) -> Tensor:
    """Weights rounded to the panel's levels, with the gradient of the identity (straight-through).

    Rounding has a zero gradient almost everywhere; passing the gradient on unchanged lets training
    see the panel's real levels (Bengio, Leonard and Courville 2013).
    """
    steps = panel.levels - 1
    rounded = (weights * steps).round() / steps
    return weights + (rounded - weights).detach()
