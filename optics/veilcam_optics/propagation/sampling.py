"""Sampling: uniform grids, exact area coverage, and FFT lengths that are fast.

A grid never has a "middle sample" that depends on its parity: sample ``i`` of ``n`` lies at
``(i - (n - 1) / 2) * pitch + centre``, for odd and even ``n`` alike.
"""

import math
from dataclasses import dataclass
from typing import Self

import torch
from scipy.fft import next_fast_len
from torch import Tensor

from veilcam_optics.errors import require, require_count, require_positive

Real = float | Tensor
"""A physical quantity: a number, or a zero-dimensional tensor that may require a gradient."""


def as_float(value: Real) -> float:
    """Return the plain number, detached from any graph: for sizes and checks."""
    return float(value.detach()) if isinstance(value, Tensor) else float(value)


def as_scalar(argument: str, value: Real, device: torch.device | None = None) -> Tensor:
    """Return ``value`` as a float64 scalar that keeps its graph; refuse NaN and infinity."""
    scalar = torch.as_tensor(value, dtype=torch.float64, device=device)
    require(scalar.ndim == 0, argument, f"tensor of shape {tuple(scalar.shape)}", "", "one number")
    require(bool(torch.isfinite(scalar)), argument, as_float(scalar), "", "a finite number")
    return scalar


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """A uniform sampling of a plane: ``rows x columns`` samples, pitches and centre in metres."""

    rows: int
    columns: int
    pitch_y: Real
    pitch_x: Real
    centre_y: Real = 0.0
    centre_x: Real = 0.0

    def __post_init__(self) -> None:
        require_count("grid.rows", self.rows)
        require_count("grid.columns", self.columns)
        require_positive("grid.pitch_y", as_float(self.pitch_y), "m")
        require_positive("grid.pitch_x", as_float(self.pitch_x), "m")

    @classmethod
    def square(cls, rows: int, columns: int, pitch: Real) -> Self:
        """Return a centred grid with the same ``pitch`` [m] along both axes."""
        return cls(rows, columns, pitch, pitch)

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (rows, columns) of arrays on this grid."""
        return self.rows, self.columns

    @property
    def height(self) -> float:
        """Extent along y, cell edges included [m]."""
        return self.rows * as_float(self.pitch_y)

    @property
    def width(self) -> float:
        """Extent along x, cell edges included [m]."""
        return self.columns * as_float(self.pitch_x)

    def y(self, device: torch.device | None = None) -> Tensor:
        """Return the row positions [m], shape (rows,), float64."""
        return axis(self.rows, self.pitch_y, self.centre_y, device)

    def x(self, device: torch.device | None = None) -> Tensor:
        """Return the column positions [m], shape (columns,), float64."""
        return axis(self.columns, self.pitch_x, self.centre_x, device)


def axis(count: int, pitch: Real, centre: Real = 0.0, device: torch.device | None = None) -> Tensor:
    """Return ``count`` sample positions [m] around ``centre``, float64."""
    step = as_scalar("pitch", pitch, device)
    index = torch.arange(count, dtype=torch.float64, device=step.device) - (count - 1) / 2
    return index * step + as_scalar("centre", centre, step.device)


def covering_grid(height: float, width: float, pitch: float) -> Grid:
    """Return the smallest centred grid of square cells that covers ``height x width`` [m]."""
    require_positive("pitch", pitch, "m")
    # The allowance keeps 507.0000000001 cells from becoming 508.
    rows, columns = (max(1, math.ceil(extent / pitch - 1e-9)) for extent in (height, width))
    return Grid.square(rows, columns, pitch)


def coverage(low: Tensor, high: Tensor, count: int, pitch: float, centre: float = 0.0) -> Tensor:
    """Return which fraction of every grid cell each interval ``[low, high]`` covers.

    Args:
        low: Lower ends of the intervals [m], shape (k,).
        high: Upper ends [m], shape (k,).
        count: Number of cells.
        pitch: Length of a cell [m].
        centre: Centre of the grid [m].

    Returns:
        Fractions in [0, 1], shape (k, count), float64. ``fractions.sum(1) * pitch`` is the length
        of the part of each interval that lies on the grid, exactly.
    """
    cells = axis(count, pitch, centre, low.device)
    upper = torch.minimum(high[:, None].double(), cells + pitch / 2)
    lower = torch.maximum(low[:, None].double(), cells - pitch / 2)
    return (upper - lower).clamp(min=0) / pitch


def tiled(count: int, side: float, cells: int, pitch: float, centre: float = 0.0) -> Tensor:
    """Return the :func:`coverage` of ``count`` intervals of length ``side`` [m] around zero."""
    low = (torch.arange(count, dtype=torch.float64) - count / 2) * side
    return coverage(low, low + side, cells, pitch, centre)


def fast_length(least: int) -> int:
    """Return the smallest length >= ``least`` with no prime factor above 5: a fast FFT."""
    require_count("least", least)
    return int(next_fast_len(least, real=True))


def area_average(values: Tensor, rows: int, columns: int, fill: float = 1.0) -> Tensor:
    """Average arrays (..., n, m) over ``rows x columns`` equal boxes, fractions of samples exact.

    Args:
        values: Samples that fill the same rectangle as the boxes.
        rows: Boxes along y.
        columns: Boxes along x.
        fill: Side of a box, as a share of the boxes' distance.

    Returns:
        Shape (..., rows, columns); of full boxes the mean is that of ``values``. Differentiable.

    Raises:
        OpticsError: If a count is not a positive integer.
    """
    require_count("rows", rows)
    require_count("columns", columns)

    def shares(boxes: int, samples: int) -> Tensor:
        width = fill * samples / boxes
        low = axis(boxes, samples / boxes, device=values.device) - width / 2
        return (coverage(low, low + width, samples, 1.0) / width).to(values.dtype)

    return shares(rows, values.shape[-2]) @ values @ shares(columns, values.shape[-1]).mT
