"""Fields of apertures in the boxes of a few offsets, and what the boxes make of their products.

In NumPy, whose calls take less than those of torch: there are many small ones.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from veilcam_optics.transfer.factored import aperture_fields
from veilcam_optics.transfer.kernels import Axis

Values = npt.NDArray[Any]

_CELLS = 24
"""Fewest cells in the box of an offset."""

_NODES_IN_FRINGE = 2.2
"""Above 2: each product of two fields is limited to a band, and these are enough to know it."""

_FARTHEST = 2.0
"""Strays over the distance that a series is asked about."""


def box_cells(side: float, wavelength: float, distance: float, apart: float) -> int:
    """Cells of a box of ``side`` [m] that resolve the fringes of points ``apart`` [m]."""
    return math.ceil(max(_CELLS, _NODES_IN_FRINGE * side * apart / (wavelength * distance)))


class BoxFields:
    """Fields in the cells of the boxes of an axis's offsets; see :func:`~...kernels.box_kernel`.

    Args:
        axis: axis with diffraction, and with the offsets that are wanted.
        of: indices of the apertures.
        wavelength: [m].
        reach: greatest distance of two apertures that interfere, in apertures.

    Attributes:
        points: middles of cells [m], (offsets, cells).
        fields: complex128 (offsets, cells, apertures).
    """

    def __init__(self, axis: Axis[Values], of: Values, wavelength: float, reach: int) -> None:
        outer = (axis.pixel + float(axis.image)) / 2
        pitch = float(axis.centres[1] - axis.centres[0]) if len(axis.centres) > 1 else 0.0
        apart = axis.width + min(reach, len(axis.centres) - 1) * pitch
        cells = box_cells(2 * outer, wavelength, float(axis.distance), apart)
        edges = np.linspace(-outer, outer, cells + 1)
        self._shares: Values = np.diff(_antiderivative(axis, edges, 1))[:, None]
        self.points = axis.offsets[:, None] + (edges[1:] + edges[:-1]) / 2
        self._near = within_reach(of, reach)
        self._axis, self._of, self._wavelength = axis, of, wavelength
        self.fields = _fields(axis, self.points, of, wavelength)

    def integrated(self, one: Values, other: Values) -> Values:
        """Integrals of ``kappa one[r] conj(other[s])``, (offsets, apertures, apertures)."""
        found: Values = ((one * self._shares).swapaxes(1, 2) @ other.conj()) * self._near
        return found

    @cached_property
    def excess(self) -> Values:
        """Excess of the stray over the range of any series, at least 1, as :attr:`fields`.

        From an aperture's nearer edge to a point that does not face it.
        """
        away = abs(self.points[..., None] - self._axis.centres[self._of]) - self._axis.width / 2
        found: Values = np.maximum(away / (float(self._axis.distance) * _FARTHEST), 1)
        return found

    def strays(self, most: int) -> list[Values]:
        """Fields of light times powers of its stray, as :attr:`fields`; powers 0 to ``most``.

        The stray of light is how far it comes along the axis from aperture to sensor, over the
        distance. Partial integration of ``v^n exp(i pi v^2 / (lambda D))`` leads to lower powers.
        Light that strays by more than two distances is taken for straying by two: no series holds
        farther out.
        """
        axis, wavelength, distance = self._axis, self._wavelength, float(self._axis.distance)
        shadow = 1 / (1 + distance / float(axis.source_distance))
        points = self.points[..., None] / distance
        scale = wavelength * shadow / (2j * math.pi * distance)
        edges = []
        for side in (axis.width / 2, -axis.width / 2):
            at = (axis.centres[self._of] + side) / distance - shadow * points
            phase = math.pi * distance / (wavelength * shadow) * at**2
            edges.append((at, math.sqrt(distance / wavelength) * np.exp(1j * phase)))
        moments = [self.fields]
        for power in range(1, most + 1):
            (above, wave), (below, other) = edges
            ends = above ** (power - 1) * wave - below ** (power - 1) * other
            if power > 1:
                ends = ends - (power - 1) * moments[power - 2]
            moments.append(scale * ends)
        straight = (1 - shadow) * points
        excess = self.excess
        found = [self.fields]
        for power in range(1, most + 1):
            stray = np.zeros_like(self.fields)
            for k in range(power + 1):
                factor = math.comb(power, k) * (-1) ** k
                stray += factor * straight ** (power - k) * moments[k]
            found.append(stray / excess**power)
        return found


def _antiderivative(axis: Axis[Values], at: Values, times: int) -> Values:
    """So many times, of the trapezoid ``kappa``: its second derivative is four deltas."""
    outer, inner = (axis.pixel + float(axis.image)) / 2, abs(axis.pixel - float(axis.image)) / 2
    found = np.zeros_like(at)
    for corner, sign in ((-outer, 1), (-inner, -1), (inner, -1), (outer, 1)):
        found += sign * np.maximum(at - corner, 0) ** (times + 1) / math.factorial(times + 1)
    whole: Values = axis.scale * found
    return whole


def integrals(axis: Axis[Values], of: Values, wavelength: float, reach: int) -> Values:
    """Integrals of ``kappa F_r conj(F_s)``, (offsets, apertures, apertures), r, s within reach."""
    if axis.shadow:
        alone: Values = axis.kernel(axis.fields(wavelength), of, of)
        return alone[:, :, None] * np.eye(len(of))
    boxes = BoxFields(axis, of, wavelength, reach)
    return boxes.integrated(boxes.fields, boxes.fields)


@dataclass(frozen=True, slots=True)
class Straightening:
    """Change of :func:`integrals` where products of fields are straight between nodes.

    That goes with the square of the nodes' distance: half of it leaves a quarter. Where a box holds
    all light the square cancels. What is left goes with the fourth power, and with where the box's
    corners are among the nodes; it is overestimated by a quarter.

    Attributes:
        step: distance of an operator's nodes, its whole multiples [m].
    """

    step: float

    def __call__(self, axis: Axis[Values], of: Values, wavelength: float, reach: int) -> Values:
        """For the pairs of the apertures ``of``, (offsets, apertures, apertures)."""
        half = self.step / 2
        outer = (axis.pixel + float(axis.image)) / 2
        first = 2 * np.floor((axis.offsets - outer) / self.step)[:, None]
        nodes = half * (first + np.arange(-2, 2 * math.ceil(2 * outer / self.step) + 5))
        # A hat is one at its node and zero at all others: its second derivative is three deltas.
        below = _antiderivative(axis, nodes - axis.offsets[:, None], 2)
        shares = -np.diff(below, 2)[:, 1:-1] / half
        shares[:, ::2] += (below[:, :-4] - 2 * below[:, 2:-2] + below[:, 4:])[:, ::2] / self.step
        fields = _fields(axis, nodes[:, 2:-2], of, wavelength)
        weighted = fields * (4 / 3 * shares)[..., None]
        found: Values = (weighted.swapaxes(1, 2) @ fields.conj()) * within_reach(of, reach)
        return found


def _fields(axis: Axis[Values], points: Values, of: Values, wavelength: float) -> Values:
    """Fields of some apertures at ``points`` (offsets, n): (offsets, n, apertures)."""
    fields = aperture_fields(
        points.reshape(-1),
        axis.centres[of],
        axis.width,
        wavelength=wavelength,
        source_distance=axis.source_distance,
        distance=axis.distance,
    )
    return fields.reshape(*points.shape, len(of))


def within_reach(of: Values, reach: int) -> Values:
    """Return which pairs of the apertures ``of`` are at most ``reach`` apart, a matrix."""
    near: Values = abs(of[:, None] - of) <= reach
    return near
