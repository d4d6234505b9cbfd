"""Coded apertures of maximum length sequences, and cells of any mask on a grid."""

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
