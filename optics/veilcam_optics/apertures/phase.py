"""Phase masks: an ideal lens, a tape-like diffuser, and a contour mask."""

import math

import torch
from torch import Tensor

from veilcam_optics.apertures.coded import pinhole
from veilcam_optics.errors import require, require_count, require_positive, require_shape
from veilcam_optics.propagation import AngularSpectrum
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


def lens(grid: Grid, focal_length: float, wavelength: float, *, diameter: float) -> Tensor:
    """Return an ideal thin lens, exp(-i pi r^2 / (wavelength f)) in a round pupil.

    J. W. Goodman, "Introduction to Fourier Optics", equation 5-10. Without dispersion: the focal
    length is that of every wavelength.

    Raises:
        OpticsError: If a length is not positive, or the grid too coarse for the phase at the rim.
    """
    for name, value in (("focal_length", focal_length), ("diameter", diameter)):
        require_positive(name, value, "m")
    require_positive("wavelength", wavelength, "m")
    pitch = max(as_float(grid.pitch_y), as_float(grid.pitch_x))
    rim = min(diameter / 2, math.hypot(grid.height / 2, grid.width / 2))
    finest = wavelength * focal_length / (2 * rim)
    sampled = rim * pitch / (wavelength * focal_length) <= 0.5
    require(sampled, "grid.pitch", pitch, "m", f"at most {finest:.3e} m for this lens")
    squared = grid.y().square()[:, None] + grid.x().square()
    curvature = unit_phasor(-torch.pi / (wavelength * focal_length) * squared, torch.complex128)
    return curvature * pinhole(grid, diameter / 2)


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


def contour_pattern(
    grid: Grid, *, spacing: float, width: float, generator: torch.Generator
) -> Tensor:
    """Return the irradiance of a contour PSF: bright lines where smooth noise changes its sign.

    V. Boominathan et al., "PhlatCam: Designed phase-mask based thin lensless camera", IEEE TPAMI
    42, 1618 (2020), section 4; smooth Gaussian noise takes the place of Perlin's.

    Args:
        grid: places of the PSF's samples.
        spacing: Correlation distance of the noise, about the distance of lines [m].
        width: width of a line [m].
        generator: Source of the noise.

    Returns:
        Shape of the grid, float64, of mean 1.

    Raises:
        OpticsError: If a length is not positive or lines are wider than their spacing.
    """
    require_positive("width", width, "m")
    require(width < spacing, "width", width, "m", f"less than the spacing, {spacing:.3e} m")
    noise = diffuser_height(grid, roughness=1.0, correlation=spacing, generator=generator)
    slopes = torch.gradient(
        noise,
        spacing=(as_float(grid.pitch_y), as_float(grid.pitch_x)),
        dim=(0, 1),
    )
    slope = (slopes[0].square() + slopes[1].square()).sqrt().clamp(min=1e-3 / spacing)
    lines = torch.exp(-((2 * noise / slope / width) ** 2))
    return lines / lines.mean()


def phase_for_pattern(
    pattern: Tensor,
    grid: Grid,
    *,
    distance: float,
    wavelength: float,
    iterations: int = 50,
    generator: torch.Generator,
) -> Tensor:
    """Return the phase mask (unit amplitude) whose irradiance at ``distance`` is near ``pattern``.

    Near-field phase retrieval: to and fro between mask and sensor, keeping the phase and replacing
    the amplitude in both planes (R. W. Gerchberg and W. O. Saxton, Optik 35, 237 (1972)).

    Args:
        pattern: Irradiance wanted, shape of the grid.
        grid: Sampling of both planes, taken as one period.
        distance: Mask to sensor [m].
        wavelength: [m].
        iterations: Rounds.
        generator: Source of the first phase.

    Returns:
        Phase [rad], shape of the grid, float64.

    Raises:
        OpticsError: If the pattern has another shape, is negative, or has no light.
    """
    require_count("iterations", iterations)
    require_positive("distance", distance, "m")
    require_shape("pattern", pattern, *grid.shape)
    require(
        bool((pattern >= 0).all()) and float(pattern.sum()) > 0,
        "pattern",
        "an irradiance",
        "",
        "values >= 0, not all zero",
    )
    wanted = (pattern.double() / pattern.double().mean()).sqrt()
    method = AngularSpectrum(padding="none")
    there = method.prepare(grid, grid, distance, wavelength)
    back = method.prepare(grid, grid, -distance, wavelength)
    phase = TURN * torch.rand(grid.shape, generator=generator, dtype=torch.float64)
    for _ in range(iterations):
        arrived = there(unit_phasor(phase, torch.complex128))
        phase = back(wanted * torch.exp(1j * arrived.angle())).angle()
    return phase
