"""How an object is shown to the camera: as it is, or somewhere else, larger, turned, tilted.

The paper's tests of robustness. Each draws a batch of images into a scene, every image in its own
random way, fast enough to do it afresh in every epoch.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, grid_sample, pad

from veilcam_optics.geometry import Camera, Scene
from veilcam_optics.parts import Part
from veilcam_training.errors import TrainingError

HEIGHTS = (0.02, 0.20)
"""Least and largest height of an object that is rescaled [m] (the paper, section 5)."""
ANGLE = 90.0
"""Largest angle of an object that is rotated, to either side [degrees] (the paper)."""
PLACES = 16
"""At how many places the objects of one step of training are, when they are shifted."""
DISTORTION = 0.5
"""How far a corner moves inwards, as a share of half a side (the paper)."""


class Change(ABC):
    """Draws images into ``scene``."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    @abstractmethod
    def __call__(self, images: Tensor, generator: torch.Generator) -> Tensor:
        """Return scenes.

        Args:
            images: (batch, rows, columns) or (batch, 3, rows, columns), in [0, 1].
            generator: of what is drawn at random, on the CPU.

        Returns:
            (batch, rows, columns) or (batch, 3, rows, columns) of the scene, black around the
            object.
        """

    def in_parts(
        self, images: Tensor, generator: torch.Generator
    ) -> Iterator[tuple[Tensor, Part | None]]:
        """The scenes, some at a time, as parts of the scene beyond which it is black.

        What training takes, where it is cheaper than the scenes as a whole.

        Args:
            images: as above.
            generator: as above.

        Yields:
            Scenes of the next images, and which part of ``scene`` they are: None for all of it.
        """
        yield self(images, generator), None


class Unchanged(Change):
    """The image is the scene."""

    def __call__(self, images: Tensor, generator: torch.Generator) -> Tensor:
        """Return ``images``."""
        del generator
        return images


class Shift(Change):
    """The object is anywhere wholly in the sensor's view, by whole pixels."""

    def __init__(self, image: Scene, camera: Camera) -> None:
        pixel = image.pixel_at_sensor(camera)
        # The allowance keeps 110.0000 pixels from becoming 109.
        rows, columns = (
            math.floor(side / pixel + 1e-6) for side in (camera.sensor.height, camera.sensor.width)
        )
        if rows < image.rows or columns < image.columns:
            raise TrainingError(
                f"an object of {image.rows} x {image.columns} pixels does not fit the sensor's "
                f"view of {rows} x {columns}: use a smaller or more distant scene"
            )
        super().__init__(replace(image, rows=rows, columns=columns, height=rows * image.pixel))

    def __call__(self, images: Tensor, generator: torch.Generator) -> Tensor:
        """Return each image at a place of its own."""
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

    def in_parts(
        self, images: Tensor, generator: torch.Generator
    ) -> Iterator[tuple[Tensor, Part | None]]:
        """``PLACES`` places, each with an equal share of the images.

        A scene that moves is a mask that moves the other way: every place costs a camera one small
        transfer, where the whole scene costs one of twenty times as many pixels.
        """
        groups = images.tensor_split(max(1, min(PLACES, len(images))))
        tops, lefts = self._places(images, len(groups), generator)
        for group, top, left in zip(groups, tops.tolist(), lefts.tolist(), strict=True):
            yield group, Part(top, left, *images.shape[-2:])

    def _places(
        self, images: Tensor, count: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """First rows and columns of ``count`` places where such images lie wholly in the scene."""
        rows, columns = images.shape[-2:]
        tops = torch.randint(self.scene.rows - rows + 1, (count,), generator=generator)
        lefts = torch.randint(self.scene.columns - columns + 1, (count,), generator=generator)
        return tops, lefts


class Rescale(Change):
    """The object's height is anything from 2 to 20 cm."""

    def __init__(self, image: Scene, heights: tuple[float, float] = HEIGHTS) -> None:
        self._factors = tuple(height / image.height for height in heights)
        rows, columns = (math.ceil(self._factors[1] * side - 1e-6) for side in image.shape)
        super().__init__(replace(image, rows=rows, columns=columns, height=rows * image.pixel))

    def __call__(self, images: Tensor, generator: torch.Generator) -> Tensor:
        """Return each image in a size of its own."""
        low, high = self._factors
        factors = low + (high - low) * torch.rand(len(images), generator=generator)
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


class Rotate(Change):
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


class Perspective(Change):
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


def homographies(sources: Tensor, target: Tensor) -> Tensor:
    """The maps (batch, 3, 3) that take points ``sources`` (batch, 4, 2) to ``target`` (4, 2)."""
    x, y = sources.double().unbind(-1)
    u, v = target.double().expand(len(sources), 4, 2).unbind(-1)
    one, zero = torch.ones_like(x), torch.zeros_like(x)
    first = torch.stack([x, y, one, zero, zero, zero, -u * x, -u * y], dim=-1)
    second = torch.stack([zero, zero, zero, x, y, one, -v * x, -v * y], dim=-1)
    solved = torch.linalg.solve(torch.cat([first, second], 1), torch.cat([u, v], 1))
    return torch.cat([solved, solved.new_ones(len(x), 1)], 1).reshape(-1, 3, 3)


def warp(images: Tensor, matrices: Tensor, shape: tuple[int, int], *, reduce: int = 1) -> Tensor:
    """Draw each image through a map of its own, bilinearly, on black.

    Args:
        images: (batch, rows, columns) or (batch, channels, rows, columns).
        matrices: (batch, 3, 3); each takes a place (x, y, 1) of the result to a place in its image,
            both in pixels from the centre.
        shape: rows and columns of the result.
        reduce: side of the squares of image pixels that are averaged first.

    Returns:
        (batch, [channels,] rows, columns).
    """
    planes = images if images.ndim == 4 else images[:, None]
    if reduce > 1:
        extra = [-side % reduce for side in planes.shape[-2:]]
        top, left = extra[0] // 2, extra[1] // 2
        planes = pad(planes, (left, extra[1] - left, top, extra[0] - top))
        # Uneven padding moves the centre by half a pixel.
        centre = torch.tensor([left - extra[1] / 2, top - extra[0] / 2])
        planes = avg_pool2d(planes, reduce)
    else:
        centre = torch.zeros(2)
    half = torch.tensor(planes.shape[:-3:-1]) * (reduce / 2)
    y, x = (torch.arange(count) - (count - 1) / 2 for count in shape)
    # Into the units of grid_sample. Rows and columns enter by a sum, so no place is multiplied out.
    to_grid = torch.eye(3)
    to_grid[:2] = torch.cat([torch.diag(1 / half), (centre / half)[:, None]], dim=1)
    mapped = (to_grid @ matrices.float()).to(images)[..., None, None]
    x, y = x.to(images), y.to(images)[:, None]
    places = mapped[:, :2, 0] * x + (mapped[:, :2, 1] * y + mapped[:, :2, 2])
    if bool((matrices[:, 2, :2] != 0).any()):
        depth = mapped[:, 2:, 0] * x + (mapped[:, 2:, 1] * y + mapped[:, 2:, 2])
        # Beyond the horizon of a perspective space folds over: nothing is there.
        places = torch.where(depth > 1e-6, places / depth, 2e3)
    places = places.permute(0, 2, 3, 1)
    drawn = grid_sample(planes, places, mode="bilinear", align_corners=False)
    return drawn if images.ndim == 4 else drawn[:, 0]


CHANGES: Mapping[str, Callable[[Scene, Camera], Change]] = {
    "none": lambda image, _camera: Unchanged(image),
    "shift": Shift,
    "rescale": lambda image, _camera: Rescale(image),
    "rotate": lambda image, _camera: Rotate(image),
    "perspective": lambda image, _camera: Perspective(image),
}


def make_change(name: str, image: Scene, camera: Camera) -> Change:
    """Change ``name`` for images shown as ``image`` says.

    Raises:
        TrainingError: an unknown name, or an object larger than the sensor's view.
    """
    if name not in CHANGES:
        raise TrainingError(f"change {name!r} is unknown: use one of {', '.join(CHANGES)}")
    return CHANGES[name](image, camera)
