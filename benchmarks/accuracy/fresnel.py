"""Fresnel (paraxial) diffraction by transfer function and by impulse response.

J. W. Goodman, "Introduction to Fourier Optics", equations 4-14 (convolution) and 4-21 (transfer
function). Which of the two is well sampled depends on the distance: D. Voelz, "Computational
Fourier Optics", section 5.4.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from veilcam_optics.errors import require, require_within
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
from veilcam_optics.propagation.spectral import (
    Spectrum,
    convolved,
    full_lengths,
    same_pitch,
)

PARAXIAL_PHASE = 0.3
"""Largest phase error [rad] of the steepest ray at which Fresnel is called accurate."""


@dataclass(frozen=True, slots=True)
class FresnelTransfer:
    """Paraxial transfer function exp(-i pi wavelength z f^2): for short distances.

    Attributes:
        guard: Share of additional padding, as in the angular spectrum.
        band_limit: Drop the frequencies whose rays miss the window; off only to compare.
    """

    name: ClassVar[str] = "fresnel transfer function"
    guard: float = 0.25
    band_limit: bool = True

    def __post_init__(self) -> None:
        require_within("guard", self.guard, "", 0, math.inf)

    def supports(self, source: Grid, target: Grid, distance: Real, wavelength: Real) -> Support:
        """Accurate while rays are flat and the transfer function is sampled finely enough."""
        z, length = check_job(distance, wavelength, None)
        for axis, pitch, window in _sides(source, target):
            if abs(as_float(length) * as_float(z)) > window * (1 + self.guard) * pitch:
                return Support(False, f"undersampled along {axis} at this distance")
        return _paraxial(source, target, as_float(z), as_float(length))

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
        """See the interface, :class:`Propagator`; ``distance`` may be negative."""
        z, length = check_job(distance, wavelength, device)
        spectrum = Spectrum(source, target, full_lengths(source, target, self.guard), device)
        fy, fx = spectrum.fy, spectrum.fx
        chirp_y = unit_phasor(-torch.pi * length * z * fy.square(), dtype)
        chirp_x = unit_phasor(-torch.pi * length * z * fx.square(), dtype)
        transfer = chirp_y[:, None] * chirp_x
        if self.band_limit:
            travel_y, travel_x = (z * length * fy)[:, None], z * length * fx
            share = spectrum.band_limit(travel_y, travel_x)
            transfer = transfer * share.to(real_type(dtype))
        return spectrum.filtered_by(transfer)


@dataclass(frozen=True, slots=True)
class FresnelImpulse:
    """Paraxial impulse response exp(i pi r^2 / (wavelength z)) / (i wavelength z): for long ones.

    The kernel separates, so a target of any pitch and shift costs two matrix products.
    """

    name: ClassVar[str] = "fresnel impulse response"

    def supports(self, source: Grid, target: Grid, distance: Real, wavelength: Real) -> Support:
        """Accurate while rays are flat and the impulse response is sampled finely enough."""
        z, length = check_job(distance, wavelength, None)
        offsets = (
            abs(as_float(target.centre_y) - as_float(source.centre_y)),
            abs(as_float(target.centre_x) - as_float(source.centre_x)),
        )
        for (axis, pitch, window), offset in zip(_sides(source, target), offsets, strict=True):
            if abs(as_float(length) * as_float(z)) < (window + 2 * offset) * pitch:
                return Support(False, f"undersampled along {axis} at this distance")
        return _paraxial(source, target, as_float(z), as_float(length))

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
        require(
            as_float(z) != 0,
            "distance",
            0,
            "m",
            "another method than the impulse response, or not 0",
        )
        y, x = source.y(device), source.x(device)
        v, u = target.y(device), target.x(device)
        # -i for the two axes together, where each contributes exp(-i pi / 4).
        scale = source.pitch_y * source.pitch_x / (length * z)
        factor = scale * torch.tensor(-1j, dtype=torch.complex128, device=y.device)
        if same_pitch(source, target):
            return _convolution(
                source, target, area=z * length, factor=factor, dtype=dtype, device=device
            )
        rows = unit_phasor(torch.pi / (length * z) * (v[:, None] - y).square(), dtype)
        columns = unit_phasor(torch.pi / (length * z) * (u[:, None] - x).square(), dtype)
        rows = rows * factor.to(dtype)
        return separable(source, rows, columns)


def separable(source: Grid, rows: Tensor, columns: Tensor) -> Propagation:
    """Return the propagation of a separable kernel: (target, source) samples along y and x."""

    def propagate(field: Tensor) -> Tensor:
        check_field(field, source, rows.dtype)
        return rows @ field @ columns.mT

    return propagate


def _convolution(
    source: Grid,
    target: Grid,
    *,
    area: Tensor,
    factor: Tensor,
    dtype: torch.dtype,
    device: torch.device | None,
) -> Propagation:
    """Return the linear convolution with both axes' chirps; ``area`` is wavelength x distance."""
    lengths = full_lengths(source, target, 0)
    y, x = source.y(device), source.x(device)
    v, u = target.y(device), target.x(device)

    def kernel(first: Tensor, given: int, wanted: int, pitch: Real, length: int) -> Tensor:
        # Lags from -(given - 1) to wanted - 1, those below zero stored at the far end.
        lag = torch.arange(length, dtype=torch.float64, device=device)
        lag = torch.where(lag < wanted, lag, lag - length)
        chirp = unit_phasor(torch.pi / area * (first + lag * pitch).square(), dtype)
        inside = (lag > -given) & (lag < wanted)
        spectrum: Tensor = torch.fft.fft(chirp * inside)
        return spectrum

    rows = kernel(v[0] - y[0], source.rows, target.rows, source.pitch_y, lengths[0])
    columns = kernel(u[0] - x[0], source.columns, target.columns, source.pitch_x, lengths[1])
    return convolved(source, target, (rows * factor.to(dtype))[:, None] * columns)


def _sides(source: Grid, target: Grid) -> tuple[tuple[str, float, float], ...]:
    """Return (axis, pitch, window) of both axes; the window holds every lag twice over."""
    return (
        ("y", as_float(source.pitch_y), source.height + target.height),
        ("x", as_float(source.pitch_x), source.width + target.width),
    )


def _paraxial(source: Grid, target: Grid, distance: float, wavelength: float) -> Support:
    """Compare the next term of the phase, pi r^4 / (4 wavelength z^3), with what is allowed."""
    if distance == 0:
        return Support(True)
    reach_sine = 0.0
    for _, pitch, window in _sides(source, target):
        steepest = min(0.99, wavelength / (2 * pitch))
        sampled = steepest / math.sqrt(1 - steepest**2)
        reach_sine += min(window / 2 / abs(distance), sampled) ** 2
    phase = TURN / 8 * reach_sine**2 * abs(distance) / wavelength
    if phase > PARAXIAL_PHASE:
        return Support(False, f"the steepest ray's paraxial phase is off by {phase:.2g} rad")
    return Support(True)
