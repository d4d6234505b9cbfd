"""Small random changes of training images, so that a classifier does not learn them by heart."""

from __future__ import annotations

import math
from typing import Annotated

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from veilcam_training.transforms.warp import warp


class Jitter(BaseModel):
    """Largest changes, to either side; all 0 changes nothing."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    rotation: Annotated[float, Field(ge=0, le=180)] = 0.0
    """[degrees]."""
    scale: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Share of the size."""
    shift: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Share of the image's sides."""
    mirror: bool = False
    """Left and right are swapped in one half of the images."""

    @property
    def any(self) -> bool:
        """True if anything changes."""
        return self.mirror or max(self.rotation, self.scale, self.shift) > 0


def jitter(images: Tensor, changes: Jitter, generator: torch.Generator) -> Tensor:
    """Each image changed in its own way.

    Args:
        images: (batch, rows, columns) or (batch, 3, rows, columns).
        changes: the largest ones.
        generator: of what is drawn, on the CPU.

    Returns:
        The same shape; what comes in from outside is black.
    """
    count, (rows, columns) = len(images), images.shape[-2:]
    draw = 2 * torch.rand(5, count, generator=generator) - 1
    angle = math.radians(changes.rotation) * draw[0]
    shrink = 1 / (1 + changes.scale * draw[1])
    flip = torch.where(draw[4] < 0, -1.0, 1.0) if changes.mirror else torch.ones(count)
    matrices = torch.zeros(count, 3, 3)
    matrices[:, 0, 0] = flip * shrink * angle.cos()
    matrices[:, 0, 1] = -flip * shrink * angle.sin()
    matrices[:, 1, 0] = shrink * angle.sin()
    matrices[:, 1, 1] = shrink * angle.cos()
    matrices[:, 0, 2] = changes.shift * columns * draw[2]
    matrices[:, 1, 2] = changes.shift * rows * draw[3]
    matrices[:, 2, 2] = 1
    return warp(images, matrices, (rows, columns))
