"""Fields of apertures in the boxes of a few offsets, and what the boxes make of their products."""

import math

import torch
from torch import Tensor

from veilcam_optics.transfer.factored import aperture_fields
from veilcam_optics.transfer.kernels import Axis

_CELLS = 24
"""Fewest cells in the box of an offset."""

_NODES_IN_FRINGE = 2.2
"""Above 2: each product of two fields is limited to a band, and these are enough to know it."""


def box_cells(side: float, wavelength: float, distance: float, apart: float) -> int:
    """Cells of a box of ``side`` [m] that resolve the fringes of points ``apart`` [m]."""
    return math.ceil(max(_CELLS, _NODES_IN_FRINGE * side * apart / (wavelength * distance)))


class BoxFields:
    """Fields in the cells of the boxes of an axis's offsets; see :func:`~...kernels.box_kernel`.

    Args:
        axis: with diffraction, and with the offsets that are wanted.
        of: indices of the apertures.
        wavelength: [m].
        reach: how far apart two apertures may be, in apertures, to be counted as interfering.

    Attributes:
        fields: complex128 (offsets, cells, apertures).
    """

    def __init__(self, axis: Axis, of: Tensor, wavelength: float, reach: int) -> None:
        pixel, image = axis.pixel, float(axis.image)
        outer, inner = (pixel + image) / 2, abs(pixel - image) / 2
        pitch = float(axis.centres[1] - axis.centres[0]) if len(axis.centres) > 1 else 0.0
        apart = axis.width + min(reach, len(axis.centres) - 1) * pitch
        cells = box_cells(2 * outer, wavelength, float(axis.distance), apart)
        edges = torch.linspace(-outer, outer, cells + 1, dtype=torch.float64)
        below = torch.zeros_like(edges)
        for corner, sign in ((-outer, 1), (-inner, -1), (inner, -1), (outer, 1)):
            below += sign * (edges - corner).clamp_min(0).square() / 2
        self._shares = (axis.scale * below.diff())[:, None]
        self._near = _near(of, reach)
        points = axis.offsets[:, None] + (edges[1:] + edges[:-1]) / 2
        self.fields = _fields(axis, points, of, wavelength)

    def integrated(self, one: Tensor, other: Tensor) -> Tensor:
        """Integrals of ``kappa one[r] conj(other[s])``, (offsets, apertures, apertures)."""
        return ((one * self._shares).mT @ other.conj()) * self._near


def integrals(axis: Axis, of: Tensor, wavelength: float, reach: int) -> Tensor:
    """Integrals of ``kappa F_r conj(F_s)``, (offsets, apertures, apertures), r, s within reach."""
    if axis.shadow:
        return torch.diag_embed(axis.kernel(axis.fields(wavelength), of, of))
    boxes = BoxFields(axis, of, wavelength, reach)
    return boxes.integrated(boxes.fields, boxes.fields)


def bends(axis: Axis, of: Tensor, wavelength: float, reach: int) -> Tensor:
    """Second derivative by the offset of :func:`integrals`, same shape: four points of a box."""
    outer, inner = (axis.pixel + float(axis.image)) / 2, (axis.pixel - float(axis.image)) / 2
    corners = torch.tensor([-outer, -inner, inner, outer], dtype=torch.float64)
    signs = torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64)
    fields = _fields(axis, axis.offsets[:, None] + corners, of, wavelength)
    weighted = fields * (axis.scale * signs)[:, None]
    return (weighted.mT @ fields.conj()) * _near(of, reach)


def _fields(axis: Axis, points: Tensor, of: Tensor, wavelength: float) -> Tensor:
    """Fields of some apertures at ``points`` (offsets, n): (offsets, n, apertures)."""
    fields = aperture_fields(
        points.flatten(),
        axis.centres[of],
        axis.width,
        wavelength=wavelength,
        source_distance=axis.source_distance,
        distance=axis.distance,
    )
    return fields.reshape(*points.shape, len(of))


def _near(of: Tensor, reach: int) -> Tensor:
    return (of[:, None] - of).abs() <= reach
