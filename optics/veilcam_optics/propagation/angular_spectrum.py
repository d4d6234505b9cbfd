"""Band-limited angular spectrum, with shifted and scaled output.

K. Matsushima and T. Shimobaba, "Band-limited angular spectrum method for numerical simulation of
free-space propagation in far and near fields", Opt. Express 17, 19662 (2009); shifted:
K. Matsushima, Opt. Express 18, 18453 (2010).
"""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from veilcam_optics.errors import require_choice, require_within
from veilcam_optics.propagation.base import (
    TURN,
    Propagation,
    Support,
    check_job,
    real_type,
    unit_phasor,
)
from veilcam_optics.propagation.sampling import Grid, Real, as_float, fast_length
from veilcam_optics.propagation.spectral import Spectrum, full_lengths, target_samples

Padding = Literal["full", "reach", "none"]

FEWEST_FRINGES = 12
"""Error about 3 / fringes^2 for a beam much wider than the target, measured against direct sums."""


@dataclass(frozen=True, slots=True)
class AngularSpectrum:
    """Exact scalar propagation of the sampled field, in either direction.

    Attributes:
        padding: ``"full"`` pads to source + target: no ray can wrap around. ``"reach"`` pads only
            as far as the steepest sampled ray travels sideways: much less at short distances, and
            only weak edge waves wrap around. ``"none"`` takes the field as one period of a
            periodic one.
        guard: Share of additional padding in ``"full"``, used for a soft edge of the band limit: a
            sharp one rings far into the target.
        band_limit: Drop the frequencies whose rays miss the window, which the sampled transfer
            function cannot represent. Switch it off only to compare.
    """

    padding: Padding = "full"
    guard: float = 0.25
    band_limit: bool = True

    def __post_init__(self) -> None:
        require_choice("padding", self.padding, ("full", "reach", "none"))
        require_within("guard", self.guard, "", 0, math.inf)

    def supports(self, source: Grid, target: Grid, distance: Real, wavelength: Real) -> Support:
        """Accurate where no frequency is dropped, or the flank of the band limit is soft enough."""
        z, length = check_job(distance, wavelength, None)
        if self.padding == "none":
            return Support(True)
        for axis, pitch, window in (
            ("y", as_float(source.pitch_y), source.height + target.height),
            ("x", as_float(source.pitch_x), source.width + target.width),
        ):
            padded = window * (1 + self.guard)
            limit = 1 / (as_float(length) * math.hypot(1, 2 * as_float(z) / padded))
            fringes = (padded - window) * limit
            if limit < 0.5 / pitch and fringes < FEWEST_FRINGES:
                reason = f"the guard along {axis} holds {fringes:.2g} fringes of the band limit"
                return Support(False, f"{reason}, {FEWEST_FRINGES} are needed")
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
        """See the interface, :class:`Propagator`; ``distance`` may be negative."""
        z, length = check_job(distance, wavelength, device)
        lengths = self._lengths(source, target, as_float(z), as_float(length))
        spectrum = Spectrum(source, target, lengths, device)
        sy, sx = (length * spectrum.fy)[:, None], length * spectrum.fx
        s = sy.square() + sx.square()
        root = _root_of_gap(s)
        transfer = _transfer(s, root, z, length, dtype)
        if self.band_limit:
            cosine = root.clamp(min=1e-9)
            share = spectrum.band_limit(z * sy / cosine, z * sx / cosine)
            transfer = transfer * share.to(real_type(dtype))
        return spectrum.filtered_by(transfer)

    def _lengths(
        self, source: Grid, target: Grid, distance: float, wavelength: float
    ) -> tuple[int, int]:
        full = full_lengths(source, target, self.guard)
        if self.padding == "full":
            return full
        if self.padding == "none":
            return source.shape
        sine_y = wavelength / (2 * as_float(source.pitch_y))
        sine_x = wavelength / (2 * as_float(source.pitch_x))
        cosine_squared = 1 - sine_y**2 - sine_x**2
        if cosine_squared <= 0.01:
            return full
        travel = abs(distance) / math.sqrt(cosine_squared)
        wanted = target_samples(source, target)
        travel_y = travel * sine_y + abs(as_float(target.centre_y) - as_float(source.centre_y))
        travel_x = travel * sine_x + abs(as_float(target.centre_x) - as_float(source.centre_x))
        rows = _reach(source.rows, wanted[0], travel_y / as_float(source.pitch_y))
        columns = _reach(source.columns, wanted[1], travel_x / as_float(source.pitch_x))
        return min(full[0], rows), min(full[1], columns)


def _reach(given: int, wanted: int, travel: float) -> int:
    """Return the length at which a ray that wraps around still misses the target.

    A quarter of the travel and 16 samples are added for the waves that spread beyond the rays.
    """
    return fast_length(max(given, wanted, math.ceil((given + wanted) / 2 + 1.25 * travel + 16)))


def _root_of_gap(s: Tensor) -> Tensor:
    """Return sqrt(|1 - s|), with a finite gradient (zero) at s = 1 where the slope is infinite."""
    gap = (1 - s).abs()
    edge = gap < 1e-12
    root = torch.where(edge, torch.ones_like(gap), gap).sqrt()
    return torch.where(edge, torch.zeros_like(gap), root)


def _transfer(
    s: Tensor, root: Tensor, distance: Tensor, wavelength: Tensor, dtype: torch.dtype
) -> Tensor:
    """Return exp(2 pi i z (sqrt(1 - s) - 1) / wavelength) without cancellation in the root."""
    propagates = s < 1
    turns = torch.where(propagates, -s / (1 + root), -torch.ones_like(s))
    transfer = unit_phasor(TURN * distance / wavelength * turns, dtype)
    # Evanescent waves decay in both directions: growing ones would be noise times exp(large).
    decay = torch.where(propagates, torch.zeros_like(s), TURN * distance.abs() / wavelength * root)
    return transfer * torch.exp(-decay).to(real_type(dtype))
