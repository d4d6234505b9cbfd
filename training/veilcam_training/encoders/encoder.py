"""What every camera does: a linear map from scene to embedding, then noise.

All of them are used in the same way, so that a comparison compares the cameras alone.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.parts import Part, embed_lit
from veilcam_training.encoders.setup import Setup


class Encoder(nn.Module, ABC):
    """A camera as ``v = x T``; ``trainable`` says whether T has parameters.

    ``constant`` says whether T is the same in every step, so that a noiseless reading need be
    computed only once.
    """

    trainable: bool = False
    constant: bool = False

    def __init__(self, setup: Setup) -> None:
        super().__init__()
        self.setup = setup

    @abstractmethod
    def transfer(self, part: Part | None = None, grid: int = 0) -> Tensor:
        """T, of shape ``setup.matrix_shape``; for a part of the scene only the rows of its pixels.

        Args:
            part: of the scene; None for all of it.
            grid: which of ``setup.grids`` the scene is on.

        Raises:
            OpticsError: a part that is not wholly in the scene.
        """

    def forward(self, scenes: Tensor, part: Part | None = None, grid: int = 0) -> Tensor:
        """Noiseless embeddings.

        Args:
            scenes: (batch, rows, columns) or (batch, 3, rows, columns), in [0, 1].
            part: which part of the scene ``scenes`` are; the rest is black. None for all of it.
            grid: which of ``setup.grids`` the scene is on.

        Returns:
            (batch, ``setup.outputs``).
        """
        if self.setup.colour:
            transfer = self.transfer(part, grid)
            seen = torch.einsum("bcp,cpe->bce", scenes.flatten(2), transfer).flatten(1)
        else:
            whole = Part(0, 0, *self.setup.grids[grid].shape)
            seen = embed_lit(scenes, part or whole, lambda lit: self.transfer(lit, grid))
        # A transfer is relative to a white scene of its own size.
        return seen * self.setup.light(grid) if grid else seen

    def _of_part(self, matrix: Tensor, part: Part | None, grid: int) -> Tensor:
        """Those rows of the whole T that belong to pixels of ``part``."""
        if part is None:
            return matrix
        scene = self.setup.grids[grid]
        part.check(scene)
        pixels = matrix.reshape(*matrix.shape[:-2], *scene.shape, -1)
        pixels = pixels.narrow(-3, part.top, part.rows).narrow(-2, part.left, part.columns)
        return pixels.flatten(-3, -2)

    def add_noise(self, values: Tensor, snr_db: float, generator: torch.Generator) -> Tensor:
        """Noise of the sensor at the delivered signal-to-noise ratio ``snr_db`` [dB]."""
        return shot_noise(values, snr_db, generator)

    def project(self) -> None:
        """Bring the parameters back into what the device can show, after an optimiser's step."""


class FixedEncoder(Encoder):
    """A camera that does not learn: its transfer is a constant.

    Args:
        setup: camera, scene and reading.
        matrices: T on each of ``setup.grids``.
    """

    constant = True

    def __init__(self, setup: Setup, matrices: Sequence[Tensor]) -> None:
        super().__init__(setup)
        for grid, matrix in enumerate(matrices):
            self.register_buffer(f"matrix_{grid}", matrix)

    def transfer(self, part: Part | None = None, grid: int = 0) -> Tensor:
        """T, a constant."""
        return self._of_part(self.get_buffer(f"matrix_{grid}"), part, grid)
