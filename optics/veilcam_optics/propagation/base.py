"""Base of all propagators, which carry a field from one plane to another."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from veilcam_optics.errors import require, require_choice, require_shape
from veilcam_optics.propagation.sampling import Grid, Real, as_float, as_scalar

Propagation = Callable[[Tensor], Tensor]
"""A prepared propagation: complex field (..., rows, columns) of the source to the target grid."""

TURN = 2 * torch.pi

_COMPLEX = {torch.float32: torch.complex64, torch.float64: torch.complex128}


@dataclass(frozen=True, slots=True)
class Support:
    """Verdict whether a method is accurate for a job, and why not. True or false itself."""

    ok: bool
    reason: str = ""

    def __bool__(self) -> bool:
        return self.ok


class Propagator(Protocol):
    """One method of free-space propagation.

    All methods leave out the carrier exp(2 pi i distance / wavelength): it changes no irradiance,
    and in float32 it would cost every digit of the phase.
    """

    def supports(self, source: Grid, target: Grid, distance: Real, wavelength: Real) -> Support:
        """Say whether the method is accurate for this job; never raises on valid input."""

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
        """Compute everything that does not depend on the field, and return the rest.

        Args:
            source: Sampling of the given field.
            target: Sampling of the wanted field; may be shifted, and scaled where the method can.
            distance: distance from source to target plane [m].
            wavelength: wavelength in the medium [m].
            dtype: complex64 or complex128, the type of the fields to be propagated.
            device: device of the fields.

        Raises:
            OpticsError: If an argument has no physical meaning or the method cannot do the job.
        """


def unit_phasor(phase: Tensor, dtype: torch.dtype) -> Tensor:
    """Return exp(i phase): float64 phase reduced modulo 2 pi first, and only then cast."""
    require_choice("phase", phase.dtype, [torch.float64])
    reduced = torch.remainder(phase, TURN).to(real_type(dtype))
    return torch.complex(torch.cos(reduced), torch.sin(reduced))


def real_type(dtype: torch.dtype) -> torch.dtype:
    """Return the real type that belongs to a complex ``dtype``."""
    require_choice("dtype", dtype, _COMPLEX.values())
    return dtype.to_real()


def complex_type(dtype: torch.dtype) -> torch.dtype:
    """Return the complex type that belongs to a real ``dtype``."""
    require_choice("dtype", dtype, _COMPLEX)
    return _COMPLEX[dtype]


def check_field(field: Tensor, source: Grid, dtype: torch.dtype) -> None:
    """Refuse a field that does not match what was prepared."""
    require_shape("field", field, ..., *source.shape)
    require_choice("field.dtype", field.dtype, [dtype])


def check_job(
    distance: Real, wavelength: Real, device: torch.device | None
) -> tuple[Tensor, Tensor]:
    """Return distance and wavelength as float64 scalars, refusing what has no meaning."""
    z = as_scalar("distance", distance, device)
    length = as_scalar("wavelength", wavelength, device)
    require(as_float(length) > 0, "wavelength", as_float(length), "m", "a finite number > 0")
    return z, length
