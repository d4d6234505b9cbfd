"""Where the object is in the scene: shift, rescale, rotate and perspective, seeded per image.

The paper's transformations ("Privacy-Enhancing Optical Embeddings for Lensless Classification",
robustness to real-world changes), in metres and degrees instead of pixels.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from veilcam_optics.camera.geometry import Scene
from veilcam_optics.errors import OpticsError, invalid, require_count, require_positive


@dataclass(frozen=True, slots=True)
class SceneTransform:
    """Draws a picture somewhere into a scene: same seed and image index, same place.

    Attributes:
        canvas: The scene to draw into; its height bounds where objects can be.
        object_height: Least and largest height of the object [m].
        shift: Whether the object lies anywhere wholly inside the canvas, or in its middle.
        rotation: Least and largest angle [degrees].
        perspective: How far corners move inwards, as a share of half a side; 0 to 1.
        seed: Of everything random.
        supersampling: Samples per canvas pixel and axis, so that small objects do not alias.
    """

    canvas: Scene
    object_height: tuple[float, float]
    shift: bool = False
    rotation: tuple[float, float] = (0.0, 0.0)
    perspective: float = 0.0
    seed: int = 0
    supersampling: int = 3

    def __post_init__(self) -> None:
        for height in self.object_height:
            require_positive("object_height", height, "m")
        for name, (low, high) in (
            ("object_height", self.object_height),
            ("rotation", self.rotation),
        ):
            if not (math.isfinite(low) and math.isfinite(high) and low <= high):
                raise invalid(name, (low, high), "", "two finite numbers, the lesser first")
        if not 0 <= self.perspective < 1:
            raise invalid("perspective", self.perspective, "", "a share in [0, 1)")
        require_count("supersampling", self.supersampling)

    def __call__(self, images: Tensor, indices: Sequence[int]) -> Tensor:
        """Return one scene per image.

        Args:
            images: Shape (batch, rows, columns) or (batch, channels, rows, columns), float.
            indices: Which image of the data set each is: with the seed, it alone decides the draw,
                whatever the batch is made of.

        Returns:
            Shape (batch, [channels,] rows, columns) of the canvas, black around the object.
            Differentiable in ``images``.

        Raises:
            OpticsError: If the shapes do not match, or an object does not fit the canvas.
        """
        if images.ndim not in (3, 4) or not images.is_floating_point():
            shown = f"{images.dtype} of shape {tuple(images.shape)}"
            raise invalid("images", shown, "", "floats (batch, [channels,] rows, columns)")
        if len(indices) != len(images):
            raise invalid("indices", f"{len(indices)} numbers", "", f"one per image, {len(images)}")
        planes = images if images.ndim == 4 else images[:, None]
        if not len(planes):
            return images.new_zeros((*images.shape[:-2], *self.canvas.shape))
        aspect = images.shape[-1] / images.shape[-2]
        corners = torch.stack([self.corners(index, aspect) for index in indices])
        grid = self._where_to_read(corners).to(images)
        # Beyond the picture's edge there is black, not the mirror or the last pixel.
        drawn = functional.grid_sample(
            planes, grid, mode="bilinear", padding_mode="zeros", align_corners=False
        )
        drawn = functional.avg_pool2d(drawn, self.supersampling)
        return drawn if images.ndim == 4 else drawn[:, 0]

    def corners(self, index: int, aspect: float = 1.0) -> Tensor:
        """Return where image ``index`` has its corners: (y, x) [m], shape (4, 2).

        The order is top left, top right, bottom right, bottom left. ``aspect`` is width / height.

        Raises:
            OpticsError: If the object is larger than the canvas.
        """
        draw = torch.rand(12, generator=_generator(self.seed, index), dtype=torch.float64)
        low, high = self.object_height
        height = low + (high - low) * float(draw[0])
        square = torch.tensor([[-1, -1], [-1, 1], [1, 1], [1, -1]], dtype=torch.float64) / 2
        # Inwards: towards the middle along both axes, each corner by its own two numbers.
        moved = square * (1 - self.perspective * draw[1:9].reshape(4, 2))
        moved = moved * torch.tensor([height, height * aspect], dtype=torch.float64)
        start, end = self.rotation
        angle = math.radians(start + (end - start) * float(draw[9]))
        turn = torch.tensor(
            [[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]],
            dtype=torch.float64,
        )
        moved = moved @ turn.mT
        half = torch.tensor(self.canvas.shape, dtype=torch.float64) * self.canvas.pixel / 2
        room = half - moved.abs().amax(0)
        if not self.shift:
            return moved
        if bool((room < -1e-12).any()):
            raise OpticsError(
                f"an object {height:.3g} m tall does not fit the canvas, {self.canvas.height:.3g} m"
                " tall: use a smaller object_height, or shift=False"
            )
        lowest, highest = -half - moved.amin(0), half - moved.amax(0)
        return moved + lowest + (highest - lowest) * draw[10:12]

    def _where_to_read(self, corners: Tensor) -> Tensor:
        """Return, for every fine canvas sample, the place in the picture in [-1, 1] (x, y)."""
        to_picture = _homography(corners)
        rows, columns = (count * self.supersampling for count in self.canvas.shape)
        step = self.canvas.pixel / self.supersampling
        y = (torch.arange(rows, dtype=torch.float64) - (rows - 1) / 2) * step
        x = (torch.arange(columns, dtype=torch.float64) - (columns - 1) / 2) * step
        points = torch.stack(
            [y[:, None].expand(rows, columns), x.expand(rows, columns), x.new_ones(rows, columns)],
            dim=-1,
        )
        mapped = torch.einsum("bij,yxj->byxi", to_picture, points)
        depth = mapped[..., 2:]
        place = mapped[..., :2] / torch.where(depth.abs() < 1e-9, torch.ones_like(depth), depth)
        # Behind the horizon of a perspective the division folds space over: nothing is there.
        return torch.where(depth > 1e-9, place, torch.full_like(place, 2e3)).flip(-1)


def _generator(seed: int, index: int) -> torch.Generator:
    """Return a generator of its own for every image; neighbours share nothing."""
    digest = hashlib.blake2b(f"{seed}:{index}".encode(), digest_size=8).digest()
    return torch.Generator().manual_seed(int.from_bytes(digest, "big") >> 1)


def _homography(corners: Tensor) -> Tensor:
    """Return the maps (batch, 3, 3) that take (y, x, 1) at the corners to (+-1, +-1, 1)."""
    ends = torch.tensor([[-1, -1], [-1, 1], [1, 1], [1, -1]], dtype=torch.float64)
    ends = ends.expand(len(corners), 4, 2)
    # In units of the object's size, or the system is as ill-conditioned as metres are far from 1.
    scale = corners.abs().amax((1, 2)).clamp(min=1e-12)[:, None]
    y, x = (corners / scale[:, None]).unbind(-1)
    one, zero = torch.ones_like(y), torch.zeros_like(y)
    v, u = ends.unbind(-1)
    first = torch.stack([y, x, one, zero, zero, zero, -v * y, -v * x], dim=-1)
    second = torch.stack([zero, zero, zero, y, x, one, -u * y, -u * x], dim=-1)
    solved = torch.linalg.solve(torch.cat([first, second], 1), torch.cat([v, u], 1))
    matrix = torch.cat([solved, torch.ones(len(corners), 1, dtype=torch.float64)], 1)
    shrink = torch.ones(len(corners), 3, dtype=torch.float64)
    shrink[:, :2] = 1 / scale
    return matrix.reshape(-1, 3, 3) * shrink[:, None, :]
