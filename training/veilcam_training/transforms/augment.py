"""Random small changes of training images."""

from __future__ import annotations

import math
from typing import Annotated

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor
from torch.nn.functional import affine_grid, grid_sample

NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Augmentation(BaseModel):
    """Random changes of a training image; uniform over plus and minus these amounts."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    rotation: NotNegative = 12.0
    """[degree]."""
    scale: Annotated[float, Field(ge=0, lt=1)] = 0.12
    shear: NotNegative = 0.15
    shift: NotNegative = 1.5
    """[pixel]."""
    mirror: bool = False
    """Left and right are swapped in every second image."""


def augment(scenes: Tensor, settings: Augmentation, generator: torch.Generator) -> Tensor:
    """Each scene rotated, scaled, sheared and shifted by its own random amounts.

    Args:
        scenes: (batch, rows, columns).
        settings: the largest amounts.
        generator: source of the random numbers, on the CPU.

    Returns:
        The same shape, by bilinear interpolation; what comes from outside is black.
    """
    count, rows, columns = scenes.shape
    random = 2 * torch.rand(6, count, generator=generator) - 1
    angle = random[0] * math.radians(settings.rotation)
    scale = 1 + random[1] * settings.scale
    shear = random[2] * settings.shear
    matrix = torch.zeros(count, 2, 3)
    matrix[:, 0, 0] = angle.cos() / scale
    matrix[:, 0, 1] = (shear - angle.sin()) / scale
    matrix[:, 1, 0] = angle.sin() / scale
    matrix[:, 1, 1] = angle.cos() / scale
    if settings.mirror:
        matrix[:, 0] *= random[5].sign()[:, None]
    matrix[:, 0, 2] = random[3] * settings.shift * 2 / columns
    matrix[:, 1, 2] = random[4] * settings.shift * 2 / rows
    grid = affine_grid(matrix, [count, 1, rows, columns], align_corners=False).to(scenes)
    return grid_sample(scenes[:, None], grid, align_corners=False)[:, 0]
