"""Illumination of the mask: a point of the scene, or a plane wave."""

import torch
from torch import Tensor

from veilcam_optics.errors import require, require_positive
from veilcam_optics.propagation.base import TURN, real_type, unit_phasor
from veilcam_optics.propagation.sampling import Grid, Real, as_float, as_scalar


def spherical_wave(
    grid: Grid,
    distance: Real,
    wavelength: Real,
    *,
    point: tuple[Real, Real] = (0.0, 0.0),
    paraxial: bool = True,
    dtype: torch.dtype = torch.complex128,
    device: torch.device | None = None,
) -> Tensor:
    """Return the wave from a point, of unit amplitude at the foot of the normal, carrier left out.

    Args:
        grid: places of the wave's samples.
        distance: distance from the point to the grid's plane [m].
        wavelength: [m].
        point: (y, x) of the point [m].
        paraxial: exp(i pi r^2 / (wavelength d)) if true, else exp(i k (R - d)) d / R.
        dtype: complex64 or complex128.
        device: device of the wave.

    Returns:
        Shape of the grid; differentiable in distance, wavelength, point and pitch.

    Raises:
        OpticsError: If distance or wavelength is not positive.
    """
    require_positive("distance", as_float(distance), "m")
    require_positive("wavelength", as_float(wavelength), "m")
    z, length = as_scalar("distance", distance, device), as_scalar("wavelength", wavelength, device)
    squared = (grid.y(device) - point[0]).square()[:, None] + (grid.x(device) - point[1]).square()
    if paraxial:
        return unit_phasor(torch.pi / (length * z) * squared, dtype)
    r = (squared + z.square()).sqrt()
    return unit_phasor(TURN / length * squared / (r + z), dtype) * (z / r).to(real_type(dtype))


def plane_wave(
    grid: Grid,
    wavelength: Real,
    *,
    direction: tuple[Real, Real] = (0.0, 0.0),
    dtype: torch.dtype = torch.complex128,
    device: torch.device | None = None,
) -> Tensor:
    """Return a plane wave of unit amplitude.

    Args:
        grid: places of the wave's samples.
        wavelength: [m].
        direction: Sines (y, x) of the angles at which it travels.
        dtype: complex64 or complex128.
        device: device of the wave.

    Returns:
        Shape of the grid; differentiable in wavelength, direction and pitch.

    Raises:
        OpticsError: If the direction is no direction, or the wavelength not positive.
    """
    require_positive("wavelength", as_float(wavelength), "m")
    sines = tuple(as_float(sine) for sine in direction)
    valid = "sines whose squares sum to less than 1"
    require(sum(sine**2 for sine in sines) < 1, "direction", sines, "", valid)
    along = grid.y(device)[:, None] * direction[0] + grid.x(device) * direction[1]
    return unit_phasor(TURN / as_scalar("wavelength", wavelength, device) * along, dtype)
