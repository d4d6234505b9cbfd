"""Geometric shadow: what is left of propagation without diffraction."""

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from benchmarks.accuracy.fresnel import separable
from veilcam_optics.errors import require, require_positive
from veilcam_optics.propagation.base import Propagation, Support, check_job, real_type
from veilcam_optics.propagation.sampling import Grid, Real, as_float


@dataclass(frozen=True, slots=True)
class GeometricShadow:
    """The source's amplitude, magnified from a point and averaged over every target cell.

    Phases do not act: the wavefront is known from ``source_distance``.

    Attributes:
        source_distance: distance from the lighting point to the mask [m]; infinite: plane wave.
    """

    name: ClassVar[str] = "geometric shadow"
    source_distance: float = math.inf

    def __post_init__(self) -> None:
        if not math.isinf(self.source_distance) or self.source_distance < 0:
            require_positive("source_distance", self.source_distance, "m")

    def supports(
        self,
        source: Grid,  # noqa: ARG002 - part of the interface
        target: Grid,
        distance: Real,
        wavelength: Real,
    ) -> Support:
        """Accurate while diffraction, about sqrt(wavelength z), stays within a target cell."""
        z, length = check_job(distance, wavelength, None)
        spread = math.sqrt(as_float(length) * abs(as_float(z)))
        cell = min(as_float(target.pitch_y), as_float(target.pitch_x))
        if spread > cell:
            reason = f"diffraction spreads {spread * 1e6:.3g} um, a cell is {cell * 1e6:.3g} um"
            return Support(False, reason)
        return Support(True)

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
            OpticsError: Also if ``distance`` is negative.
        """
        z, _ = check_job(distance, wavelength, device)
        require(
            as_float(z) >= 0,
            "distance",
            as_float(z),
            "m",
            "a distance >= 0: a shadow has no way back",
        )
        magnified = 1 + z / self.source_distance
        kind = real_type(dtype)
        rows = _overlap(
            target.y(device), target.pitch_y, source.y(device), source.pitch_y, magnified
        )
        columns = _overlap(
            target.x(device), target.pitch_x, source.x(device), source.pitch_x, magnified
        )
        # Energy is spread over magnified^2 the area, amplitude falls by magnified.
        rows, columns = (rows / magnified).to(kind).to(dtype), columns.to(kind).to(dtype)
        shadow = separable(source, rows, columns)
        return lambda field: shadow(field.abs().to(dtype))


def _overlap(target: Tensor, cell: Real, source: Tensor, pitch: Real, magnified: Tensor) -> Tensor:
    """Return which share of each target cell each magnified source cell fills."""
    centres, half = source * magnified, pitch * magnified / 2
    upper = torch.minimum(target[:, None] + cell / 2, centres + half)
    lower = torch.maximum(target[:, None] - cell / 2, centres - half)
    return (upper - lower).clamp(min=0) / cell
