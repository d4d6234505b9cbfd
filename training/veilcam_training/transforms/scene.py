"""Transforms that show an object to the camera: as it is, moved, larger, turned, tilted.

The paper's tests of robustness. Each draws a batch of images into a scene, every image in its own
random way, fast enough to do it afresh in every epoch.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Scene
from veilcam_optics.transfer.regions import Region
from veilcam_training.errors import require
from veilcam_training.transforms.warp import homographies, warp

HEIGHTS = (0.02, 0.20)
"""Least and largest height of an object that is rescaled [m] (the paper, section 5)."""
ANGLE = 90.0
"""Largest angle of an object that is rotated, to either side [degrees] (the paper)."""
PLACES = 16
"""At how many places the objects of one step of training are, when they are shifted."""
DISTORTION = 0.5
"""How far a corner moves inwards, as a share of half a side (the paper)."""


@dataclass(frozen=True)
class Shown:
    """Some images of a batch, as they are shown to a camera.

    Attributes:
        chosen: numbers of the images, int64 (count,).
        scenes: (count, rows, columns) or (count, 3, rows, columns).
        part: part of the grid that ``scenes`` are; beyond it is black. None for all of it.
        grid: number of the grid: 0 is the transform's ``scene``, the others are its ``finer`` ones.
    """

    chosen: Tensor
    scenes: Tensor
    part: Region | None = None
    grid: int = 0


class Transform(ABC):
    """Draws images into ``scene``, or into ``finer`` ones: smaller, with smaller pixels."""

    def __init__(self, scene: Scene, finer: tuple[Scene, ...] = ()) -> None:
        self.scene, self.finer = scene, finer

    @abstractmethod
    def __call__(self, images: Tensor, generator: torch.Generator) -> Tensor:
        """Return scenes.

        Args:
            images: (batch, rows, columns) or (batch, 3, rows, columns), in [0, 1].
            generator: generator of all random draws, on the CPU.

        Returns:
            (batch, rows, columns) or (batch, 3, rows, columns) of the scene, black around the
            object.
        """

    def in_parts(
        self,
        images: Tensor,
        generator: torch.Generator,
        *,
        training: bool,  # noqa: ARG002 - part of the interface
    ) -> Iterator[Shown]:
        """Yield the scenes that a camera is shown, some images at a time: by default all at once.

        Args:
            images: images as above.
            generator: generator as above.
            training: True may draw the images less independently of each other, if that is cheaper.
        """
        yield Shown(torch.arange(len(images)), self(images, generator))


class Identity(Transform):
    """The image is the scene."""

    def __call__(self, images: Tensor, generator: torch.Generator) -> Tensor:  # noqa: ARG002 - part of the interface
        """Return ``images``."""
        return images


class Moved(Transform):
    """Each image at a place of its own wholly in the scene, by whole pixels."""

    def __call__(self, images: Tensor, generator: torch.Generator) -> Tensor:
        """Return each image at its place, drawn uniformly."""
        rows, columns = images.shape[-2:]
        count = len(images)
        tops, lefts = self._places(images, count, generator)
        y = tops[:, None, None] + torch.arange(rows)[:, None]
        x = lefts[:, None, None] + torch.arange(columns)
        places = (y * self.scene.columns + x).flatten(1).to(images.device)
        channels = images.shape[1] if images.ndim == 4 else 1
        planes = images.reshape(count, channels, rows * columns)
        scenes = images.new_zeros(count, channels, self.scene.rows * self.scene.columns)
        scenes.scatter_(2, places[:, None].expand_as(planes), planes)
        return scenes.reshape(*images.shape[:-2], *self.scene.shape)

    def _places(
        self, images: Tensor, count: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """First rows and columns of ``count`` places where such images lie wholly in the scene."""
        rows, columns = images.shape[-2:]
        tops = torch.randint(self.scene.rows - rows + 1, (count,), generator=generator)
        lefts = torch.randint(self.scene.columns - columns + 1, (count,), generator=generator)
        return tops, lefts


class Anywhere(Moved):
    """The object is anywhere in the sensor's view, in training too.

    Args:
        image: size and distance at which images are shown.
        camera: camera whose sensor sees the scene.
        multiple: the scene's sides are the nearest multiples of so many pixels.
    """

    def __init__(self, image: Scene, camera: Camera, multiple: int = 1) -> None:
        rows, columns = (multiple * round(side / multiple) for side in _view(image, camera))
        super().__init__(_resized(image, rows, columns))


class Shift(Moved):
    """The object is anywhere wholly in the sensor's view."""

    def __init__(self, image: Scene, camera: Camera) -> None:
        # The allowance keeps 110.0000 pixels from becoming 109.
        rows, columns = (math.floor(side + 1e-6) for side in _view(image, camera))
        require(
            rows >= image.rows and columns >= image.columns,
            f"an object of {image.rows} x {image.columns} pixels does not fit the sensor's "
            f"view of {rows} x {columns}: use a smaller or more distant scene",
        )
        super().__init__(_resized(image, rows, columns))

    def in_parts(
        self, images: Tensor, generator: torch.Generator, *, training: bool
    ) -> Iterator[Shown]:
        """In training ``PLACES`` places, each with an equal share of the images.

        A scene that moves is a mask that moves the other way: every place costs a camera one small
        transfer, where the whole scene costs one of twenty times as many pixels.
        """
        if not training:
            yield from super().in_parts(images, generator, training=training)
            return
        groups = torch.arange(len(images)).tensor_split(max(1, min(PLACES, len(images))))
        tops, lefts = self._places(images, len(groups), generator)
        for group, top, left in zip(groups, tops.tolist(), lefts.tolist(), strict=True):
            yield Shown(group, images[group], Region(top, left, *images.shape[-2:]))


class Rescale(Transform):
    """The object's height is anything from 2 to 20 cm.

    On one grid the smallest would have five pixels instead of an image's 28, and lose what a mask
    still tells apart. So there is a grid for each octave of height: a scene half as high as the one
    before, of as many pixels. A last part of an octave goes with the octave above it.
    """

    def __init__(self, image: Scene, heights: tuple[float, float] = HEIGHTS) -> None:
        self._image, (low, high) = image, heights
        self._heights = heights
        rows, columns = (math.ceil(high / image.height * side - 1e-6) for side in image.shape)
        scene = _resized(image, rows, columns)
        halvings = range(1, round(math.log2(high / low)))
        super().__init__(
            scene, tuple(replace(scene, height=scene.height / 2**number) for number in halvings)
        )

    def __call__(self, images: Tensor, generator: torch.Generator) -> Tensor:
        """Return each image in a size of its own."""
        return self._draw(images, self.draw_heights(len(images), generator) / self._image.height)

    def draw_heights(self, count: int, generator: torch.Generator) -> Tensor:
        """Heights [m] of ``count`` images, as they are drawn first of all."""
        low, high = self._heights
        return low + (high - low) * torch.rand(count, generator=generator)

    def in_parts(
        self,
        images: Tensor,
        generator: torch.Generator,
        *,
        training: bool,  # noqa: ARG002 - part of the interface
    ) -> Iterator[Shown]:
        """Each image on the finest grid that has room for it."""
        heights = self.draw_heights(len(images), generator)
        octaves = (self._heights[1] / heights).log2().long().clamp(0, len(self.finer))
        factors = heights / self._image.height
        for octave in range(len(self.finer) + 1):
            chosen = (octaves == octave).nonzero().flatten()
            if not len(chosen) and len(images):
                continue  # a transfer that nothing is seen through
            scenes = self._draw(images[chosen.to(images.device)], factors[chosen] * 2**octave)
            yield Shown(chosen, scenes, grid=octave)

    def _draw(self, images: Tensor, factors: Tensor) -> Tensor:
        """Scenes with each image ``factors`` times as large as its pixels say."""
        matrices = torch.diag_embed(
            torch.stack([1 / factors, 1 / factors, torch.ones_like(factors)], dim=1)
        )
        # A small object has several image pixels in one of the scene's: average them first.
        levels = (1 / factors).floor().clamp_min(1).long()
        scenes = images.new_zeros(*images.shape[:-2], *self.scene.shape)
        for level in sorted(set(levels.tolist())):
            some = (levels == level).nonzero().flatten()
            chosen = some.to(images.device)
            scenes[chosen] = warp(images[chosen], matrices[some], self.scene.shape, reduce=level)
        return scenes


class Rotate(Transform):
    """The object is turned by up to 90 degrees to either side."""

    def __init__(self, image: Scene, angle: float = ANGLE) -> None:
        super().__init__(image)
        self._angle = math.radians(angle)

    def __call__(self, images: Tensor, generator: torch.Generator) -> Tensor:
        """Return each image at an angle of its own."""
        angles = self._angle * (2 * torch.rand(len(images), generator=generator) - 1)
        cosine, sine, zero, one = angles.cos(), angles.sin(), angles * 0, angles * 0 + 1
        rows = ((cosine, -sine, zero), (sine, cosine, zero), (zero, zero, one))
        matrices = torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
        return warp(images, matrices, self.scene.shape)


class Perspective(Transform):
    """The object is tilted: each of its corners moves inwards by up to a quarter of the side."""

    def __init__(self, image: Scene, distortion: float = DISTORTION) -> None:
        super().__init__(image)
        self._distortion = distortion

    def __call__(self, images: Tensor, generator: torch.Generator) -> Tensor:
        """Return each image tilted in its own way."""
        ends = torch.tensor([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        inwards = self._distortion * torch.rand(len(images), 4, 2, generator=generator)
        half = torch.tensor([images.shape[-1] / 2, images.shape[-2] / 2])
        return warp(
            images, homographies(ends * (1 - inwards) * half, ends * half), self.scene.shape
        )


TRANSFORMS: Mapping[str, Callable[[Scene, Camera], Transform]] = {
    "none": lambda image, _camera: Identity(image),
    "shift": Shift,
    "rescale": lambda image, _camera: Rescale(image),
    "rotate": lambda image, _camera: Rotate(image),
    "perspective": lambda image, _camera: Perspective(image),
}


def make_transform(name: str, image: Scene, camera: Camera) -> Transform:
    """Transform ``name`` of images shown as ``image`` says.

    Raises:
        TrainingError: an unknown name, or an object larger than the sensor's view.
    """
    require(name in TRANSFORMS, f"change {name!r} is unknown: use one of {', '.join(TRANSFORMS)}")
    return TRANSFORMS[name](image, camera)


def _view(image: Scene, camera: Camera) -> tuple[float, float]:
    """Sides of what the sensor sees, in pixels of ``image``."""
    pixel = image.pixel_at_sensor(camera)
    return camera.sensor.height / pixel, camera.sensor.width / pixel


def _resized(image: Scene, rows: int, columns: int) -> Scene:
    """Return a scene of so many of the pixels of ``image``."""
    return replace(image, rows=rows, columns=columns, height=rows * image.pixel)
