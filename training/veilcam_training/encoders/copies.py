"""Copies of the scene behind a mask: how many of them count.

A mask that hides from eyes lays many small pictures of the scene over each other. With ``h`` the
response to a bright point, less its mean over a neighbourhood,

    N' = (sum h^2)^2 / sum h^4

counts those that stand out. It is differentiable in the mask and needs no picture, so it helps a
fit. It proves nothing: :mod:`veilcam_training.hiding` measures what an eye sees.
"""

import torch
from torch import Tensor, nn
from torch.nn.functional import conv2d

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.masks import random_mask
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach

SEEN_AT = Embedding(24, 32)
"""Embedding at which copies are counted, whatever the camera's: what the panel shows."""
NEIGHBOURHOOD = 3.0
"""Standard deviation of the neighbourhood whose mean is taken off, in embedding pixels."""
RANDOM = 8
"""Random masks whose mean is what others are compared with."""
STRENGTH = 20.0
"""Weight of the penalty, beside a loss of about 1."""


class Copies(nn.Module):
    """Copies that count, of masks of one camera, as a share of those of random masks.

    Args:
        camera: camera of the masks.
        scene: scene before it; a point in its middle shines.
        colour: True counts each colour by itself, False their sum.
    """

    bell: Tensor
    inside: Tensor
    random: Tensor

    def __init__(self, camera: Camera, scene: Scene, *, colour: bool) -> None:
        super().__init__()
        point = Scene(rows=1, columns=1, height=scene.pixel, distance=scene.distance)
        self.response = TransferOperator(
            camera, point, SEEN_AT, reach=Reach(0, 0), colour=colour, dtype=torch.float32
        )
        reach = round(3 * NEIGHBOURHOOD)
        bell = torch.exp(-0.5 * (torch.arange(-reach, reach + 1) / NEIGHBOURHOOD).square())
        self.register_buffer("bell", bell / bell.sum())
        self.register_buffer("inside", self._mean(torch.ones(1, 1, *SEEN_AT.shape)))
        drawn = torch.Generator().manual_seed(0)
        masks = [random_mask(camera, drawn) for _ in range(RANDOM)]
        self.register_buffer("random", torch.stack([self.count(mask) for mask in masks]).mean(0))

    def count(self, weights: Tensor) -> Tensor:
        """Return N' of a mask, (1,) gray or (3,) in colour.

        Args:
            weights: amplitude transmittances, ``camera.mask_shape``.
        """
        seen: Tensor = self.response(weights).reshape(-1, 1, *SEEN_AT.shape)
        powers = (seen - self._mean(seen) / self.inside).square().flatten(1)
        counted: Tensor = powers.sum(1).square() / powers.square().sum(1).clamp_min(1e-30)
        return counted

    def forward(self, weights: Tensor, share: float) -> Tensor:
        """Return the penalty of a mask, a scalar: 0 where all of its counts are large enough.

        Args:
            weights: amplitude transmittances, ``camera.mask_shape``.
            share: least count of each colour, as a share of that of random masks.
        """
        missing: Tensor = 1 - self.count(weights) / (share * self.random)
        return STRENGTH * missing.clamp_min(0).square().sum()

    def _mean(self, images: Tensor) -> Tensor:
        reach = len(self.bell) // 2
        down = conv2d(images, self.bell[:, None][None, None], padding=(reach, 0))
        return conv2d(down, self.bell[None, None, None], padding=(0, reach))
