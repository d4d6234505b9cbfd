"""Small random changes of training images, so that a classifier does not learn them by heart."""

import math
from typing import Annotated

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor
from torch.nn.functional import pad

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
    crop: Annotated[int, Field(ge=0, le=16)] = 0
    """Whole pixels that an image moves; what comes in is reflected at its edge."""

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
        if self.crop:
            images = _cropped(images, self.crop, generator)
        if not (self.rotation or self.scale or self.shift or self.mirror):
            return images
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


def _cropped(images: Tensor, most: int, generator: torch.Generator) -> Tensor:
    """Images moved by up to ``most`` whole pixels each way."""
    count, (rows, columns) = len(images), images.shape[-2:]
    planes = images.reshape(count, -1, rows, columns)
    framed = pad(planes, (most,) * 4, "reflect")
    windows = framed.unfold(2, rows, 1).unfold(3, columns, 1)
    y, x = torch.randint(2 * most + 1, (2, count), generator=generator).to(images.device)
    return windows[torch.arange(count, device=images.device), :, y, x].reshape(images.shape)
