"""Base of all cameras: from scene to embedding, then noise, then the classifier's input.

All of them are used in the same way, so that a comparison compares the cameras alone.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.regions import Region, embed_lit


@dataclass(frozen=True)
class Setup:
    """Camera, scene, and how the sensor is read.

    ``point_binning`` reads the sensor at the centre of each embedding pixel, as the paper's code
    does when it shrinks a measurement without antialiasing. A real camera averages over the pixel.
    """

    camera: Camera = field(default_factory=Camera)
    scene: Scene = field(default_factory=Scene)
    embedding: Embedding = field(default_factory=Embedding)
    colour: bool = False
    """False sums the colours to a gray measurement, True keeps three."""
    point_binning: bool = False
    finer: tuple[Scene, ...] = ()
    """Scenes of smaller pixels that are shown too; each has a transfer of its own."""
    tolerance: float = 3e-3
    """Relative L2 error that the light is planned to, at the embedding."""

    @property
    def grids(self) -> tuple[Scene, ...]:
        """The scene, and the finer ones, by the number of their grid."""
        return (self.scene, *self.finer)

    def light(self, grid: int) -> float:
        """Return the light of a white scene on ``grid``, relative to that of ``scene``."""
        first, other = self.scene, self.grids[grid]
        return (other.rows * other.columns * other.pixel**2) / (
            first.rows * first.columns * first.pixel**2
        )

    @property
    def channels(self) -> int:
        """1 gray, 3 in colour."""
        return 3 if self.colour else 1

    @property
    def outputs(self) -> int:
        """Number of values of one embedding, all channels together."""
        return self.channels * self.embedding.size

    @property
    def matrix_shape(self) -> tuple[int, ...]:
        """Shape of the transfer: (scene pixels, values of a colour), after (3,) in colour."""
        shape = (self.scene.rows * self.scene.columns, self.embedding.size)
        return (3, *shape) if self.colour else shape


class Encoder(nn.Module, ABC):
    """A camera; ``trainable`` says whether it has parameters.

    ``constant`` says whether it sees the same in every step, so that a noiseless measurement need
    be computed only once.
    """

    trainable: bool = False
    constant: bool = False

    def __init__(self, setup: Setup) -> None:
        super().__init__()
        self.setup = setup

    @abstractmethod
    def forward(self, scenes: Tensor, part: Region | None = None, grid: int = 0) -> Tensor:
        """Noiseless embeddings.

        Args:
            scenes: (batch, rows, columns) or (batch, 3, rows, columns), in [0, 1].
            part: part of the scene that ``scenes`` are; the rest is black. None for all of it.
            grid: number of the scene's grid in ``setup.grids``.

        Returns:
            (batch, ``setup.outputs``).
        """

    def add_noise(self, values: Tensor, snr_db: float, generator: torch.Generator) -> Tensor:
        """Noise of the sensor at the delivered signal-to-noise ratio ``snr_db`` [dB]."""
        return shot_noise(values, snr_db, generator)

    def decode(self, measurements: Tensor) -> Tensor:
        """Return the classifier's input for noisy measurements of the last scenes: the same."""
        return measurements

    def project(self) -> None:
        """Bring the parameters back into what the device can show, after an optimiser's step."""

    def penalty(self) -> Tensor | float:
        """Return what a fit adds to its loss, a scalar: by default nothing."""
        return 0.0


class LinearEncoder(Encoder):
    """A camera as ``v = x T``, with one T for all images of a step."""

    @abstractmethod
    def transfer(self, part: Region | None = None, grid: int = 0) -> Tensor:
        """T, of shape ``setup.matrix_shape``; for a part of the scene only the rows of its pixels.

        Args:
            part: part of the scene; None for all of it.
            grid: number of the scene's grid in ``setup.grids``.

        Raises:
            OpticsError: a part that is not wholly in the scene.
        """

    def forward(self, scenes: Tensor, part: Region | None = None, grid: int = 0) -> Tensor:
        """Noiseless embeddings, see :meth:`Encoder.forward`."""
        if self.setup.colour:
            transfer = self.transfer(part, grid)
            seen = torch.einsum("bcp,cpe->bce", scenes.flatten(2), transfer).flatten(1)
        else:
            whole = Region(0, 0, *self.setup.grids[grid].shape)
            seen = embed_lit(scenes, part or whole, lambda lit: self.transfer(lit, grid))
        # A transfer is relative to a white scene of its own size.
        return seen * self.setup.light(grid) if grid else seen

    def _of_part(self, matrix: Tensor, part: Region | None, grid: int) -> Tensor:
        """Those rows of the whole T that belong to pixels of ``part``."""
        if part is None:
            return matrix
        scene = self.setup.grids[grid]
        part.check(scene)
        pixels = matrix.reshape(*matrix.shape[:-2], *scene.shape, -1)
        pixels = pixels.narrow(-3, part.top, part.rows).narrow(-2, part.left, part.columns)
        return pixels.flatten(-3, -2)


class FixedEncoder(LinearEncoder):
    """A camera that does not learn: its transfer is a constant.

    Args:
        setup: camera, scene and measurement.
        matrices: T on each of ``setup.grids``.
    """

    constant = True

    def __init__(self, setup: Setup, matrices: Sequence[Tensor]) -> None:
        super().__init__(setup)
        for grid, matrix in enumerate(matrices):
            self.register_buffer(f"matrix_{grid}", matrix)

    def transfer(self, part: Region | None = None, grid: int = 0) -> Tensor:
        """T, a constant."""
        return self._of_part(self.get_buffer(f"matrix_{grid}"), part, grid)
