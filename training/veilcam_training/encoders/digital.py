"""No camera at all: the best linear projection that a computer can learn, as a ceiling."""

import math

import torch
from torch import Tensor, nn

from veilcam_optics.transfer.regions import Region
from veilcam_training.encoders.base import LinearEncoder, Setup


class Digital(LinearEncoder):
    """An unconstrained learned projection to as many numbers as the embedding has.

    Its values have either sign, so there are no photons to count: its noise is white, at the same
    signal-to-noise ratio as that of the cameras.
    """

    trainable = True

    def __init__(self, setup: Setup, generator: torch.Generator) -> None:
        super().__init__(setup)
        shape = setup.matrix_shape
        matrix = torch.randn(shape, generator=generator) / math.sqrt(shape[-2])
        self.matrix = nn.Parameter(matrix)

    def transfer(self, part: Region | None = None, grid: int = 0) -> Tensor:
        """T, all parameters; on a finer grid, pixels share those of the pixel they lie in."""
        coarse, fine = self.setup.scene, self.setup.grids[grid]
        matrix: Tensor = self.matrix
        if grid:
            places = [
                _coarse_pixels(count, pixels, fine.pixel / coarse.pixel).to(matrix.device)
                for count, pixels in zip(fine.shape, coarse.shape, strict=True)
            ]
            chosen = (places[0][:, None] * coarse.columns + places[1]).flatten()
            matrix = matrix.index_select(-2, chosen)
        return self._of_part(matrix, part, grid)

    def add_noise(self, values: Tensor, snr_db: float, generator: torch.Generator) -> Tensor:
        """White noise at the delivered signal-to-noise ratio ``snr_db`` [dB] of each image."""
        power = values.square().mean(1, keepdim=True) * 10 ** (-snr_db / 10)
        noise = torch.randn(values.shape, generator=generator, device=values.device)
        # A black image has no noise, and no gradient of it.
        return values + power.clamp_min(torch.finfo(values.dtype).tiny).sqrt() * noise


def _coarse_pixels(count: int, pixels: int, ratio: float) -> Tensor:
    """In which of ``pixels`` each of ``count`` pixels, ``ratio`` times as large, has its middle."""
    middles = (torch.arange(count) - (count - 1) / 2) * ratio + pixels / 2
    return middles.floor().long().clamp(0, pixels - 1)
