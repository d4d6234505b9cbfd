"""Small random changes of training images, so that a classifier does not learn them by heart."""

import math
from typing import Annotated

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor
from torch.nn.functional import affine_grid, grid_sample

from veilcam_training.transforms.warp import warp


class Augmentation(BaseModel):
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
        return any(largest for _, largest in self)

    def __call__(self, images: Tensor, generator: torch.Generator) -> Tensor:
        """Each image changed in its own way, bilinearly.

        Args:
            images: (batch, rows, columns) or (batch, 3, rows, columns).
            generator: generator of the draws, on the CPU.

        Returns:
            The same shape; what comes in from outside is black.
        """
        count, (rows, columns) = len(images), images.shape[-2:]
        draw = 2 * torch.rand(5, count, generator=generator) - 1
        angle = math.radians(self.rotation) * draw[0]
        shrink = 1 / (1 + self.scale * draw[1])
        flip = torch.where(draw[4] < 0, -1.0, 1.0) if self.mirror else torch.ones(count)
        matrices = torch.zeros(count, 3, 3)
        matrices[:, 0, 0] = flip * shrink * angle.cos()
        matrices[:, 0, 1] = -flip * shrink * angle.sin()
        matrices[:, 1, 0] = shrink * angle.sin()
        matrices[:, 1, 1] = shrink * angle.cos()
        matrices[:, 0, 2] = self.shift * columns * draw[2]
        matrices[:, 1, 2] = self.shift * rows * draw[3]
        matrices[:, 2, 2] = 1
        return warp(images, matrices, (rows, columns))


class ShearedAugmentation(Augmentation):
    """The same and a shear, in an image stretched to a square; as large as a fresh camera bears.

    Unlike its base it draws a sixth number, and takes the shift in pixels: the published fits
    behind fresh masks depend on both.
    """

    rotation: Annotated[float, Field(ge=0, le=180)] = 12.0
    """[degrees]."""
    scale: Annotated[float, Field(ge=0, lt=1)] = 0.12
    """Share of the size."""
    shift: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 1.5
    """[pixels]."""
    shear: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.15
    """Columns by which a row moves, for each row from the middle."""

    def __call__(self, images: Tensor, generator: torch.Generator) -> Tensor:
        """Each image changed in its own way, bilinearly; ``images`` are (batch, rows, columns)."""
        count, rows, columns = images.shape
        draw = 2 * torch.rand(6, count, generator=generator) - 1
        angle, scale = math.radians(self.rotation) * draw[0], 1 + self.scale * draw[1]
        matrix = torch.zeros(count, 2, 3)
        matrix[:, 0, 0] = angle.cos() / scale
        matrix[:, 0, 1] = (self.shear * draw[2] - angle.sin()) / scale
        matrix[:, 1, 0] = angle.sin() / scale
        matrix[:, 1, 1] = angle.cos() / scale
        if self.mirror:
            matrix[:, 0] *= torch.where(draw[5] < 0, -1.0, 1.0)[:, None]
        matrix[:, 0, 2] = self.shift * draw[3] * 2 / columns
        matrix[:, 1, 2] = self.shift * draw[4] * 2 / rows
        grid = affine_grid(matrix, [count, 1, rows, columns], align_corners=False).to(images)
        return grid_sample(images[:, None], grid, align_corners=False)[:, 0]
