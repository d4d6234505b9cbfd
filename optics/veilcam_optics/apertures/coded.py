"""Amplitude masks that others use: MLS, MURA, Fresnel zones, pinhole."""

import math

import numpy as np
import torch
from torch import Tensor

from veilcam_optics.errors import require, require_count, require_positive
from veilcam_optics.propagation.sampling import Grid, as_float, tiled


def mls_cells(order: int = 6, repeats: int = 2) -> Tensor:
    """Return the separable mask of a maximum length sequence, 0 and 1, float64.

    The sequence (63 long at order 6, as +-1) is repeated and multiplied with itself; open where
    the product is +1. M. S. Asif et al., "FlatCam", IEEE Trans. Comput. Imaging 3, 384 (2017).

    Returns:
        Shape (n, n) with n = repeats * (2^order - 1).

    Raises:
        OpticsError: If the order is not 2 to 16 or ``repeats`` is not positive.
    """
    require_count("repeats", repeats)
    require_count("order", order, least=2)
    require(order <= 16, "order", order, "", "an integer from 2 to 16")
    from scipy.signal import max_len_seq  # noqa: PLC0415 - slow to import, and few ask for it

    bits = np.asarray(max_len_seq(order)[0], dtype=np.float64)
    signs = torch.from_numpy(2 * np.tile(bits, repeats) - 1)
    return (torch.outer(signs, signs) + 1) / 2


def mura_cells(side: int) -> Tensor:
    """Return a modified uniformly redundant array of prime ``side``, 0 and 1, float64.

    S. R. Gottesman and E. E. Fenimore, Appl. Opt. 28, 4344 (1989), equation 6. Its periodic
    correlation with the decoding array is a single peak.

    Raises:
        OpticsError: If ``side`` is not an odd prime.
    """
    require_count("side", side, least=3)
    require(
        all(side % divisor != 0 for divisor in range(2, math.isqrt(side) + 1)),
        "side",
        side,
        "",
        "an odd prime, e.g. 11, 31, 61 or 101",
    )
    residue = torch.full((side,), -1.0, dtype=torch.float64)
    residue[[number * number % side for number in range(1, side)]] = 1
    cells = (torch.outer(residue, residue) + 1) / 2
    cells[:, 0] = 1
    cells[0, :] = 0
    return cells


def mura_decoder(side: int) -> Tensor:
    """Return the decoding array of :func:`mura_cells`: +1 where open, -1 elsewhere, but one."""
    decoder = 2 * mura_cells(side) - 1
    decoder[0, 0] = 1
    return decoder


def lay_cells(cells: Tensor, feature: float, grid: Grid) -> Tensor:
    """Return the transmittance of square cells on a grid, each grid cell by area.

    Args:
        cells: Transmittance of every cell in [0, 1], shape (n, m); centred on the axis.
        feature: Side of a cell [m].
        grid: places of the mask's samples.

    Returns:
        Shape of the grid, float64; 0 beyond the cells.

    Raises:
        OpticsError: If ``feature`` is not positive.
    """
    require_positive("feature", feature, "m")
    rows, columns = (
        tiled(count, feature, samples, as_float(pitch), as_float(centre))
        for count, samples, pitch, centre in (
            (cells.shape[0], grid.rows, grid.pitch_y, grid.centre_y),
            (cells.shape[1], grid.columns, grid.pitch_x, grid.centre_x),
        )
    )
    return rows.mT @ cells.double() @ columns


def fresnel_zones(grid: Grid, radius: float, *, phase: float = 0.0, binary: bool = False) -> Tensor:
    """Return a Fresnel zone aperture, (1 + cos(pi r^2 / radius^2 - phase)) / 2.

    T. Shimano et al., "Lensless light-field imaging with Fresnel zone aperture", Appl. Opt. 57,
    2841 (2018), equation 1.

    Args:
        grid: places of the mask's samples.
        radius: radius of the innermost zone [m].
        phase: phase of the zones at the centre [rad].
        binary: Open where the above is at least 1/2, closed elsewhere.

    Raises:
        OpticsError: If ``radius`` is not positive, or zones are finer than the grid can hold.
    """
    require_positive("radius", radius, "m")
    farthest = max(float(grid.y().abs().max()), float(grid.x().abs().max()))
    pitch = max(as_float(grid.pitch_y), as_float(grid.pitch_x))
    least = math.sqrt(2 * farthest * pitch)
    require(
        2 * farthest * pitch <= radius**2,
        "radius",
        radius,
        "m",
        f"at least {least:.3e} m, or a finer or smaller grid",
    )
    squared = grid.y().square()[:, None] + grid.x().square()
    zones = (1 + torch.cos(torch.pi * squared / radius**2 - phase)) / 2
    return (zones >= 0.5).to(torch.float64) if binary else zones


def pinhole(grid: Grid, radius: float, *, parts: int = 8) -> Tensor:
    """Return a circular hole on the axis, each grid cell by area to 1 / parts^2.

    Raises:
        OpticsError: If ``radius`` is not positive, or so small that no part of a cell is open.
    """
    require_positive("radius", radius, "m")
    require_count("parts", parts)
    inner = (torch.arange(parts, dtype=torch.float64) + 0.5) / parts - 0.5
    y = (grid.y()[:, None] + inner * grid.pitch_y).flatten()
    x = (grid.x()[:, None] + inner * grid.pitch_x).flatten()
    inside = (y.square()[:, None] + x.square() <= radius**2).to(torch.float64)
    hole = inside.reshape(grid.rows, parts, grid.columns, parts).mean((1, 3))
    require(
        bool((hole > 0).any()), "radius", radius, "m", "a larger hole, a finer grid, or more parts"
    )
    return hole
