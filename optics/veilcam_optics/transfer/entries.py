"""Quadrature of single entries of a transfer: fields of apertures in the boxes of some offsets.

An entry is the light of one scene pixel in one embedding pixel. Products of aperture fields are
integrated over its own box alone, by Gauss-Legendre nodes that resolve the finest fringe. In
NumPy, whose calls take less time than those of torch: there are many small ones.
"""

import math
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from veilcam_optics.transfer.factored import aperture_fields
from veilcam_optics.transfer.kernels import Axis

Values = npt.NDArray[Any]

_NODES, _NODES_IN_FRINGE, _FRINGES = 8, 1.6, 22.0
"""Nodes of a panel: so many, and so many more for each fringe; and most fringes in a panel.

``n`` nodes integrate a wave of ``2 n / pi`` periods, and a few nodes more make the error small.
"""

_FARTHEST = 2.0
"""Largest stray, over the distance, of which a series holds."""


def node_count(side: float, fringe: float) -> int:
    """Return about how many nodes resolve fringes of a period in a box of ``side``, both [m]."""
    return 3 * _NODES + math.ceil(_NODES_IN_FRINGE * side / fringe)


def box_nodes(pixel: float, image: float, fringe: float) -> tuple[Values, Values]:
    """Return nodes from a box's middle [m], and their shares of the integral against ``kappa``.

    ``kappa`` is the trapezoid of an embedding pixel over a scene pixel's image; see
    :func:`~veilcam_optics.transfer.kernels.box_kernel`. It bends at its corners: no panel of nodes
    reaches across.

    Args:
        pixel: side of an embedding pixel [m].
        image: side of a scene pixel's image [m].
        fringe: period of the finest fringe [m].
    """
    outer, inner = (pixel + image) / 2, abs(pixel - image) / 2
    nodes, shares = [], []
    for low, high in ((-outer, -inner), (-inner, inner), (inner, outer)):
        if high - low <= 1e-9 * outer:
            continue
        fringes = (high - low) / fringe
        count = max(1, math.ceil(fringes / _FRINGES))
        at, lengths = _legendre(_NODES + math.ceil(_NODES_IN_FRINGE * fringes / count))
        half = (high - low) / count / 2
        middles = low + half * (2 * np.arange(count) + 1)
        nodes.append((middles[:, None] + half * at).ravel())
        shares.append(np.tile(half * lengths, count))
    places = np.concatenate(nodes)
    return places, np.concatenate(shares) * (outer - abs(places)).clip(0, outer - inner)


@lru_cache(maxsize=64)
def _legendre(count: int) -> tuple[Values, Values]:
    return np.polynomial.legendre.leggauss(count)


class BoxFields:
    """Fields in the boxes of an axis's offsets; see :func:`~...kernels.box_kernel`.

    Args:
        axis: axis with diffraction, and with the offsets that are wanted.
        of: indices of the apertures.
        wavelength: [m].
        reach: greatest distance of two apertures that interfere, in apertures.

    Attributes:
        points: nodes [m], (offsets, nodes).
        fields: complex128 (offsets, nodes, apertures).
    """

    def __init__(self, axis: Axis[Values], of: Values, wavelength: float, reach: int) -> None:
        count = len(axis.centres)
        pitch = float(axis.centres[1] - axis.centres[0]) if count > 1 else 0.0
        apart = float(axis.width) + min(reach, count - 1) * pitch
        fringe = wavelength * float(axis.distance) / apart
        at, shares = box_nodes(axis.pixel, float(axis.image), fringe)
        self._shares: Values = float(axis.scale) * shares[:, None]
        self.points = axis.offsets[:, None] + at
        self._near = within_reach(of, reach)
        self._axis, self._of, self._wavelength = axis, of, wavelength
        self._bright = axis.brightness(of)
        fields = aperture_fields(
            self.points.reshape(-1),
            axis.centres[of],
            axis.width,
            wavelength=wavelength,
            source_distance=axis.source_distance,
            distance=axis.distance,
        )
        self.fields = fields.reshape(*self.points.shape, len(of))

    def integrated(self, one: Values, other: Values) -> Values:
        """Integrals of ``kappa one[r] conj(other[s])``, (offsets, apertures, apertures).

        Fields are as bright as the light at their apertures.
        """
        bright = self._bright[:, :, None] * self._bright[:, None]
        found: Values = ((one * self._shares).swapaxes(1, 2) @ other.conj()) * self._near * bright
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


def integrals(axis: Axis[Values], of: Values, wavelength: float, reach: int) -> Values:
    """Integrals of ``kappa F_r conj(F_s)``, (offsets, apertures, apertures), r, s within reach."""
    if axis.shadow:
        alone: Values = axis.kernel(axis.fields(wavelength), of, of)
        return alone[:, :, None] * np.eye(len(of))
    boxes = BoxFields(axis, of, wavelength, reach)
    return boxes.integrated(boxes.fields, boxes.fields)


def within_reach(of: Values, reach: int) -> Values:
    """Return which pairs of the apertures ``of`` are at most ``reach`` apart, a matrix."""
    near: Values = abs(of[:, None] - of) <= reach
    return near
