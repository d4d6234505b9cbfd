"""Phase masks: reliefs, and the relief of a tape-like diffuser."""

import torch
from torch import Tensor

from veilcam_optics.errors import require, require_positive
from veilcam_optics.propagation.base import TURN, unit_phasor
from veilcam_optics.propagation.sampling import Grid, as_float


def phase_plate(height: Tensor, wavelength: float, *, index: float = 1.5) -> Tensor:
    """Return the transmittance of a relief: exp(2 pi i (index - 1) height / wavelength).

    Args:
        height: Thickness of the material [m], any shape, float64.
        wavelength: [m].
        index: Refractive index of the material; air around it.

    Raises:
        OpticsError: If the wavelength is not positive or the index not above 1.
    """
    require_positive("wavelength", wavelength, "m")
    require(index > 1, "index", index, "", "a refractive index > 1")
    return unit_phasor(TURN * (index - 1) / wavelength * height.double(), torch.complex128)


def diffuser_height(
    grid: Grid, *, roughness: float, correlation: float, generator: torch.Generator
) -> Tensor:
    """Return the relief of a tape-like diffuser: Gaussian noise with a Gaussian correlation.

    Args:
        grid: places of the relief's samples.
        roughness: Standard deviation of the height [m].
        correlation: Distance at which the correlation has fallen to 1/e [m].
        generator: Source of the noise.

    Returns:
        Height [m], shape of the grid, float64, of mean zero.

    Raises:
        OpticsError: If a length is not positive, or the grid too coarse for the correlation.
    """
    require_positive("roughness", roughness, "m")
    require_positive("correlation", correlation, "m")
    pitch = max(as_float(grid.pitch_y), as_float(grid.pitch_x))
    require(
        correlation >= 2 * pitch,
        "correlation",
        correlation,
        "m",
        f"at least two samples, {2 * pitch:.3e} m",
    )
    noise = torch.randn(grid.shape, generator=generator, dtype=torch.float64)
    fy = torch.fft.fftfreq(grid.rows, as_float(grid.pitch_y), dtype=torch.float64)
    fx = torch.fft.rfftfreq(grid.columns, as_float(grid.pitch_x), dtype=torch.float64)
    # The correlation is the filter with itself: each gets half of the Gaussian's exponent.
    squared = fy.square()[:, None] + fx.square()
    passed = torch.exp(-0.5 * (torch.pi * correlation) ** 2 * squared)
    relief: Tensor = torch.fft.irfft2(torch.fft.rfft2(noise) * passed, s=grid.shape)
    relief = relief - relief.mean()
    return relief / relief.square().mean().sqrt() * roughness
