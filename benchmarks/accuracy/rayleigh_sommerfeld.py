"""Rayleigh-Sommerfeld diffraction by direct summation: slow, and the reference for small sizes.

J. W. Goodman, "Introduction to Fourier Optics", equation 3-40, first kind, all terms.
"""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from veilcam_optics.errors import OpticsError, require, require_count
from veilcam_optics.propagation.base import (
    TURN,
    Propagation,
    Support,
    check_field,
    check_job,
    real_type,
    unit_phasor,
)
from veilcam_optics.propagation.sampling import Grid, Real, as_float


@dataclass(frozen=True, slots=True)
class RayleighSommerfeld:
    """Every source sample's spherical wave, added up at every target sample.

    Attributes:
        largest: Most pairs of samples it accepts; each costs about 100 operations.
    """

    name: ClassVar[str] = "rayleigh-sommerfeld"
    largest: int = 2**28

    def __post_init__(self) -> None:
        require_count("largest", self.largest)

    def supports(self, source: Grid, target: Grid, distance: Real, wavelength: Real) -> Support:
        """Accurate where neighbouring source samples differ by less than half a turn."""
        z, length = check_job(distance, wavelength, None)
        pairs = source.rows * source.columns * target.rows * target.columns
        if pairs > self.largest:
            return Support(False, f"{pairs:.1e} pairs of samples, {self.largest:.1e} are allowed")
        if as_float(z) <= 0:
            return Support(False, "only forwards, over a distance > 0")
        for axis, pitch, reach in (
            ("y", as_float(source.pitch_y), (source.height + target.height) / 2),
            ("x", as_float(source.pitch_x), (source.width + target.width) / 2),
        ):
            sine = reach / (reach**2 + as_float(z) ** 2) ** 0.5
            if pitch * sine > as_float(length) / 2:
                return Support(False, f"the source is undersampled along {axis} at this distance")
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
            OpticsError: Also if ``distance`` is not positive, or if the job is too large.
        """
        z, length = check_job(distance, wavelength, device)
        require(as_float(z) > 0, "distance", as_float(z), "m", "a distance > 0")
        if source.rows * source.columns * target.rows * target.columns > self.largest:
            raise OpticsError(
                f"a sum over {source.shape} x {target.shape} samples is too large: use the angular "
                f"spectrum, or a larger value than largest = {self.largest}"
            )
        y, x = source.y(device), source.x(device)
        v, u = target.y(device), target.x(device)
        cell = source.pitch_y * source.pitch_x
        real_type(dtype)  # refuses a dtype that is not complex before any work is done

        def row(field: Tensor, across: Tensor) -> Tensor:
            """Field along one target row; ``across`` are the squared y distances (rows,)."""
            squared = across[:, None, None] + (u - x[:, None]).square()
            r = (squared + z.square()).sqrt()
            # r - z without cancellation: the carrier is left out, as everywhere.
            phasor = unit_phasor(TURN / length * squared / (r + z), dtype)
            amplitude = torch.complex(z / r.pow(3) / TURN, -z / r.square() / length) * cell
            return torch.einsum("...yx,yxu->...u", field, amplitude.to(dtype) * phasor)

        def propagate(field: Tensor) -> Tensor:
            check_field(field, source, dtype)
            across = (v[:, None] - y).square()
            return torch.stack([row(field, line) for line in across], dim=-2)

        return propagate
