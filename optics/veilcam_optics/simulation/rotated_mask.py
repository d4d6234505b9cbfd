"""A mask that is shifted and turned by any angle, on a grid."""

import math

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.propagation.sampling import axis, covering_grid

_SAMPLES_PER_CELL = 5


class RotatedMask:
    """A turned and shifted mask as amplitudes on a grid.

    Args:
        camera: panel and window.
        pitch: pitch of the grid [m].
        rotation: rotation from x towards y [rad].
        shift_y: [m].
        shift_x: [m].
        dtype: type of the amplitudes.
    """

    def __init__(
        self,
        camera: Camera,
        pitch: float,
        *,
        rotation: float,
        shift_y: float,
        shift_x: float,
        dtype: torch.dtype,
    ) -> None:
        panel, (rows, columns) = camera.panel, camera.mask_shape
        sine, cosine = math.sin(rotation), math.cos(rotation)
        sides = covered_sides(camera, rotation, shift_y=shift_y, shift_x=shift_x)
        self.grid = covering_grid(*sides, pitch)
        cells = self.grid.rows * self.grid.columns
        y, x = (
            values - shift
            for values, shift in zip(
                (self.grid.y(), self.grid.x()), (shift_y, shift_x), strict=True
            )
        )
        inside = axis(_SAMPLES_PER_CELL, pitch / _SAMPLES_PER_CELL)
        found = []
        # A cell's samples are counted with those of its row: all at once would be 25 grids of them.
        for first, row_of_cells in zip(range(0, cells, self.grid.columns), y, strict=True):
            samples = []
            for dy in inside:
                # Each sample is turned back to where the panel is straight.
                across = (x + inside[:, None]).flatten()
                v = cosine * (row_of_cells + dy) - sine * across
                u = sine * (row_of_cells + dy) + cosine * across
                row, in_row = _aperture(v, rows, panel.pitch_y, panel.aperture_y)
                column, in_column = _aperture(u, columns, panel.pitch_x, panel.aperture_x)
                here = (in_row & in_column).nonzero().flatten()
                cell = first + here % self.grid.columns
                samples.append(cell * (rows * columns) + (row * columns + column)[here])
            found.append(torch.unique(torch.cat(samples), return_counts=True))
        pairs, counts = (torch.cat(each) for each in zip(*found, strict=True))
        cell, aperture = pairs // (rows * columns), pairs % (rows * columns)
        shares = counts.double() / _SAMPLES_PER_CELL**2
        covered = torch.zeros(cells, dtype=torch.float64).index_add(0, cell, shares)
        # The root of the covered share, so that the power through a cell is exact.
        values = (shares / covered[cell].sqrt()).to(dtype)
        self._matrix = torch.sparse_coo_tensor(
            torch.stack([cell, aperture]), values, (cells, rows * columns), check_invariants=False
        ).coalesce()

    def __call__(self, weights: Tensor) -> Tensor:
        """Amplitudes on ``grid`` of ``weights``, the mask's; differentiable."""
        amplitudes: Tensor = self._matrix @ weights.reshape(-1, 1)
        return amplitudes.reshape(self.grid.shape)


def covered_sides(
    camera: Camera, rotation: float, *, shift_y: float, shift_x: float
) -> tuple[float, float]:
    """Height and width of what holds the turned and shifted mask, centred on the axis [m]."""
    height = camera.window.rows * camera.panel.pitch_y
    width = camera.window.columns * camera.panel.pitch_x
    sine, cosine = abs(math.sin(rotation)), abs(math.cos(rotation))
    return (
        height * cosine + width * sine + 2 * abs(shift_y),
        height * sine + width * cosine + 2 * abs(shift_x),
    )


def _aperture(position: Tensor, count: int, pitch: float, width: float) -> tuple[Tensor, Tensor]:
    """Index of the nearest aperture, and whether the position lies inside it."""
    index = (position / pitch + (count - 1) / 2).round().clamp(0, count - 1)
    middle = (index - (count - 1) / 2) * pitch
    return index.long(), (position - middle).abs() <= width / 2
