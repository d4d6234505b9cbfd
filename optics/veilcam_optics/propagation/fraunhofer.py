"""Fraunhofer diffraction: the far field, on any target grid.

J. W. Goodman, "Introduction to Fourier Optics", equation 4-25.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import torch

from veilcam_optics.errors import require
from veilcam_optics.propagation.base import (
    TURN,
    Propagation,
    Support,
    check_job,
    separable,
    unit_phasor,
)
from veilcam_optics.propagation.sampling import Grid, Real, as_float


@dataclass(frozen=True, slots=True)
class Fraunhofer:
    """Fourier transform of the source, evaluated at the target's points by a matrix DFT."""

    name: ClassVar[str] = "fraunhofer"

    def supports(self, source: Grid, target: Grid, distance: Real, wavelength: Real) -> Support:
        """Accurate where the source's own curvature, pi r^2 / (wavelength z), is below 0.3 rad."""
        z, length = check_job(distance, wavelength, None)
        radius = math.hypot(
            source.height / 2 + abs(as_float(source.centre_y)),
            source.width / 2 + abs(as_float(source.centre_x)),
        )
        phase = math.pi * radius**2 / (as_float(length) * max(abs(as_float(z)), 1e-300))
        if phase > 0.3:
            return Support(False, f"not the far field: the source's curvature is {phase:.2g} rad")
        for axis, pitch, farthest in (
            ("y", as_float(source.pitch_y), target.height / 2 + abs(as_float(target.centre_y))),
            ("x", as_float(source.pitch_x), target.width / 2 + abs(as_float(target.centre_x))),
        ):
            if 2 * pitch * farthest > as_float(length) * abs(as_float(z)) * (1 + 1e-9):
                return Support(False, f"the target reaches past the source's samples along {axis}")
        return Support(True)

    def cost(self, source: Grid, target: Grid) -> float:
        """Two matrix products."""
        return 8.0 * target.rows * source.columns * (source.rows + target.columns)

    def prepare(
        self,
        source: Grid,
        target: Grid,
        distance: Real,
        wavelength: Real,
        *,
        dtype: torch.dtype = torch.complex128,
        device: torch.device | None = None,
    ) -> Propagation:
        """See the interface, :class:`Propagator`.

        Raises:
            OpticsError: Also if ``distance`` is zero.
        """
        z, length = check_job(distance, wavelength, device)
        require(as_float(z) != 0, "distance", 0, "m", "a distance in the far field")
        area = length * z
        y, x = source.y(device), source.x(device)
        v, u = target.y(device), target.x(device)
        rows = unit_phasor(
            torch.pi / area * v[:, None].square() - TURN / area * v[:, None] * y, dtype
        )
        columns = unit_phasor(
            torch.pi / area * u[:, None].square() - TURN / area * u[:, None] * x, dtype
        )
        factor = source.pitch_y * source.pitch_x / area
        rows = rows * (factor * torch.tensor(-1j, dtype=torch.complex128, device=y.device)).to(
            dtype
        )
        return separable(source, rows, columns)
