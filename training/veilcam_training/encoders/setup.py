"""What every encoder is made for: a camera that looks at a scene and is read in some way."""

from __future__ import annotations

from dataclasses import dataclass, field

from veilcam_optics.camera.geometry import Camera, Embedding, Scene


@dataclass(frozen=True)
class Setup:
    """Camera, scene, and how the sensor is read.

    ``point_reading`` reads the sensor at the centre of each embedding pixel, as the paper's code
    does when it shrinks a reading without antialiasing. A real camera averages over the pixel.
    """

    camera: Camera = field(default_factory=Camera)
    scene: Scene = field(default_factory=Scene)
    embedding: Embedding = field(default_factory=Embedding)
    colour: bool = False
    """False sums the colours to a gray reading, True keeps three."""
    point_reading: bool = False
    finer: tuple[Scene, ...] = ()
    """Scenes of smaller pixels that are shown too; each has a transfer of its own."""

    @property
    def grids(self) -> tuple[Scene, ...]:
        """The scene, and the finer ones, by the number of their grid."""
        return (self.scene, *self.finer)

    def light(self, grid: int) -> float:
        """How much light a white scene on ``grid`` sends, relative to that of ``scene``."""
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
        """How many numbers one embedding has, all channels together."""
        return self.channels * self.embedding.size

    @property
    def matrix_shape(self) -> tuple[int, ...]:
        """Shape of the transfer: (scene pixels, embedding pixels), after (3,) in colour."""
        shape = (self.scene.rows * self.scene.columns, self.embedding.size)
        return (3, *shape) if self.colour else shape
