"""Propagation against closed forms of diffraction theory, each with its tolerance."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
import torch
from scipy.special import fresnel
from tests.unit.optics.tensors import relative
from torch import Tensor

from veilcam_optics.errors import OpticsError
from veilcam_optics.propagation import AngularSpectrum
from veilcam_optics.propagation.illumination import plane_wave, spherical_wave
from veilcam_optics.propagation.sampling import Grid, coverage

Field = npt.NDArray[np.complex128]
WAVELENGTH, WAIST = 550e-9, 20e-6
RAYLEIGH = math.pi * WAIST**2 / WAVELENGTH


def box(grid: Grid, half_y: float, half_x: float) -> Tensor:
    def one(count: int, pitch: float, half: float) -> Tensor:
        ends = torch.tensor([half], dtype=torch.float64)
        return coverage(-ends, ends, count, pitch)[0]

    rows = one(grid.rows, float(grid.pitch_y), half_y)
    columns = one(grid.columns, float(grid.pitch_x), half_x)
    return (rows[:, None] * columns).to(torch.complex128)


def edge(at: Tensor, wavelength: float, distance: float) -> Field:
    """Fresnel field at ``at`` of a half plane that is open above 0 (Born and Wolf 8.7.3)."""
    s, c = fresnel(math.sqrt(2 / (wavelength * distance)) * at.numpy())
    return np.asarray(0.5 + (c + 1j * s) / (1 + 1j), dtype=np.complex128)


def slit(at: Tensor, half: float, wavelength: float, distance: float) -> Field:
    return np.subtract(edge(at + half, wavelength, distance), edge(at - half, wavelength, distance))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "fresnel_number"),
    [(AngularSpectrum(guard=2), 0.2), (AngularSpectrum(guard=1), 1.0), (AngularSpectrum(), 5.0)],
    ids=repr,
)
def test_square_aperture(method: AngularSpectrum, fresnel_number: float) -> None:
    """The field of a square is a product of Fresnel integrals (Goodman, equation 4-33)."""
    half, distance = 60e-6, (60e-6) ** 2 / WAVELENGTH / fresnel_number
    source, target = Grid.square(241, 240, 0.5e-6), Grid.square(60, 61, 4e-6)
    got = method.prepare(source, target, distance, WAVELENGTH)(box(source, half, half))
    rows = slit(target.y(), half, WAVELENGTH, distance)
    columns = slit(target.x(), half, WAVELENGTH, distance)
    assert relative(got, rows[:, None] * columns) < 1.5e-2


@pytest.mark.parametrize("shape", [(1, 4001), (4001, 1)])
def test_knife_edge(shape: tuple[int, int]) -> None:
    """Irradiance 1/4 at the geometric edge, first fringe 1.37 (Born and Wolf 8.7.3)."""
    distance, middle = 1e-3, slice(1950, 2051)  # far from where the period ends
    line = shape[0] == 1
    # One row or one column is a slit across; the direction along it is what is looked at.
    source = Grid(*shape, 1e-6 if not line else 50e-6, 1e-6 if line else 50e-6)
    target = Grid(*shape, source.pitch_y, source.pitch_x)
    along = source.x() if line else source.y()
    field = (along > 0).to(torch.complex128).reshape(shape)
    field = field + 0.5 * (along == 0).to(torch.complex128).reshape(shape)
    got = AngularSpectrum(padding="none", band_limit=False).prepare(
        source, target, distance, WAVELENGTH
    )(field)
    irradiance = got.abs().square().flatten()
    wanted = np.abs(edge(along, WAVELENGTH, distance)[middle]) ** 2
    assert float(irradiance[2000]) == pytest.approx(0.25, abs=5e-3)
    assert float(irradiance[middle].max()) == pytest.approx(1.37, abs=0.01)
    assert np.abs(irradiance[middle].numpy() - wanted).max() < 0.02


def disc(grid: Grid, radius: float, parts: int = 8) -> Tensor:
    """A circular aperture by area, each cell divided into parts x parts."""
    pitch = float(grid.pitch_y)
    steps = (torch.arange(parts, dtype=torch.float64) + 0.5) / parts - 0.5
    y = (grid.y()[:, None] + steps * pitch).flatten()
    x = (grid.x()[:, None] + steps * pitch).flatten()
    inside = ((y.square()[:, None] + x.square()) <= radius**2).to(torch.float64)
    return inside.reshape(grid.rows, parts, grid.columns, parts).mean((1, 3)).to(torch.complex128)


@pytest.mark.slow
@pytest.mark.parametrize("fresnel_number", [0.5, 1.0, 2.0, 3.0])
def test_circular_aperture_on_axis(fresnel_number: float) -> None:
    """Exact on the axis: U = 1 - z / sqrt(z^2 + a^2) exp(ik (sqrt(z^2 + a^2) - z))."""
    radius = 50e-6
    distance = radius**2 / WAVELENGTH / fresnel_number
    source = Grid.square(201, 201, 0.5e-6)
    hypotenuse = math.hypot(distance, radius)
    phase = 2 * math.pi / WAVELENGTH * radius**2 / (hypotenuse + distance)
    wanted = 1 - distance / hypotenuse * np.exp(1j * phase)
    # At even Fresnel numbers the axis is dark, so the error is relative to the open field.
    wide = Grid.square(101, 101, 0.5e-6)
    spectrum = AngularSpectrum(guard=4)
    assert spectrum.supports(source, wide, distance, WAVELENGTH)
    got = spectrum.prepare(source, wide, distance, WAVELENGTH)(disc(source, radius))
    assert abs(complex(got[50, 50]) - wanted) < 1e-2


def test_arago_spot() -> None:
    """Behind an opaque disc the axis is as bright as without it, times z^2 / (z^2 + a^2)."""
    radius, distance = 40e-6, 1.5e-3
    grid = Grid.square(601, 601, 1e-6)
    # A Gaussian beam instead of a plane wave, so that the light ends inside the grid.
    waist = 110e-6
    beam = torch.exp(-(grid.y().square()[:, None] + grid.x().square()) / waist**2)
    blocked = beam * (1 - disc(grid, radius))
    target = Grid.square(21, 21, 1e-6)
    run = AngularSpectrum().prepare(grid, target, distance, WAVELENGTH)
    spot = run(blocked).abs().square()
    # Without an edge at infinity only the disc's rim sends light to the axis, exactly in phase:
    # U(0) = exp(-a^2 (1/w^2 - i k / 2z)) / (1 + i z / z_R) up to phase (Fresnel).
    rayleigh = math.pi * waist**2 / WAVELENGTH
    wanted = math.exp(-2 * radius**2 / waist**2) / (1 + (distance / rayleigh) ** 2)
    assert float(spot[10, 10]) == pytest.approx(wanted, rel=2e-2)
    assert float(spot[10, 10]) == float(spot.max())
    assert float(spot[10, 4]) < 0.5 * wanted


def gaussian(grid: Grid, z: float) -> Tensor:
    """Waist, curvature and Gouy phase of a beam (Siegman, Lasers, chapter 17)."""
    squared = grid.y().square()[:, None] + grid.x().square()
    q = 1 + 1j * z / RAYLEIGH
    return torch.exp(-squared / (WAIST**2 * q)) / q


@pytest.mark.parametrize(
    ("method", "rayleigh_ranges"),
    [(AngularSpectrum(), 0.2), (AngularSpectrum(guard=1), 1.0), (AngularSpectrum(guard=3), 3.0)],
    ids=repr,
)
def test_gaussian_beam(method: AngularSpectrum, rayleigh_ranges: float) -> None:
    distance = RAYLEIGH * rayleigh_ranges
    source = Grid.square(40, 41, 3.6e-6)
    target = Grid(61, 60, 3e-6, 2.5e-6, centre_x=4e-6)
    assert method.supports(source, target, distance, WAVELENGTH)
    got = method.prepare(source, target, distance, WAVELENGTH)(gaussian(source, 0))
    assert relative(got, gaussian(target, distance)) < 3e-3


def test_talbot_distance() -> None:
    """A grating images itself at 2 p^2 / wavelength and shifts by half a period at half of it.

    Higher orders leave the paraxial distance as the fourth power of their order, so that hard
    edges come back rounded.
    """
    period, wavelength = 40e-6, 500e-9
    grid = Grid.square(4, 160, 1e-6)
    index = torch.arange(160) % 40
    grating = (index < 20).to(torch.complex128).expand(4, 160)
    talbot = 2 * period**2 / wavelength
    periodic = AngularSpectrum(padding="none", band_limit=False)
    smooth = 1 + torch.cos(2 * torch.pi * grid.x() / period).expand(4, 160).to(torch.complex128)
    exact = wavelength / (1 - math.sqrt(1 - (wavelength / period) ** 2))
    assert exact == pytest.approx(talbot, rel=1e-4)
    image = periodic.prepare(grid, grid, exact, wavelength)(smooth)
    assert relative(image, smooth) < 1e-9
    half = periodic.prepare(grid, grid, exact / 2, wavelength)(smooth)
    assert relative(half, smooth.roll(20, 1)) < 1e-9
    hard = periodic.prepare(grid, grid, talbot, wavelength)(grating)
    assert relative(hard.abs(), grating.abs()) < 0.25
    assert relative(hard.abs(), grating.roll(20, 1).abs()) > 1


def test_spherical_wave_keeps_its_centre() -> None:
    """A wave from d1 that travels d2 further is one from d1 + d2, fainter by d1 / (d1 + d2)."""
    d1, d2 = 20e-3, 2e-3
    source, target = Grid.square(500, 500, 2e-6), Grid.square(60, 60, 2e-6)
    edge_free = torch.exp(-((source.y()[:, None] / 4e-4) ** 8) - (source.x() / 4e-4) ** 8)
    wave = spherical_wave(source, d1, WAVELENGTH, point=(3e-5, -2e-5))
    got = AngularSpectrum().prepare(source, target, d2, WAVELENGTH)(wave * edge_free)
    wanted = spherical_wave(target, d1 + d2, WAVELENGTH, point=(3e-5, -2e-5)) * d1 / (d1 + d2)
    assert relative(got, wanted) < 1e-3


def test_exact_and_paraxial_spherical_waves_differ_off_axis_only() -> None:
    grid = Grid.square(101, 101, 1e-6)
    paraxial = spherical_wave(grid, 1e-3, WAVELENGTH)
    exact = spherical_wave(grid, 1e-3, WAVELENGTH, paraxial=False)
    assert abs(complex(paraxial[50, 50] - exact[50, 50])) < 1e-12
    assert 1e-3 < abs(complex(paraxial[0, 0] - exact[0, 0])) < 0.1


def test_impossible_illumination_is_refused() -> None:
    grid = Grid.square(4, 4, 1e-6)
    for bad in (0.0, -1e-3, math.nan, math.inf):
        with pytest.raises(OpticsError, match="distance"):
            spherical_wave(grid, bad, WAVELENGTH)
        with pytest.raises(OpticsError, match="wavelength"):
            plane_wave(grid, bad)
    with pytest.raises(OpticsError, match="direction"):
        plane_wave(grid, WAVELENGTH, direction=(0.8, 0.7))


def test_tilted_plane_wave_travels_sideways() -> None:
    """By z times the tangent of its angle."""
    sine, distance = 0.05, 1e-3
    source, target = Grid.square(120, 120, 1.5e-6), Grid.square(240, 240, 1e-6)
    beam = torch.exp(-(source.y().square()[:, None] + source.x().square()) / (25e-6) ** 2)
    wave = plane_wave(source, WAVELENGTH, direction=(0.0, sine))
    irradiance = AngularSpectrum().prepare(source, target, distance, WAVELENGTH)(beam * wave)
    power = irradiance.abs().square()
    centre = float((power * target.x()).sum() / power.sum())
    wanted = distance * sine / math.sqrt(1 - sine**2)
    assert centre == pytest.approx(wanted, abs=0.3e-6)
    assert float((power * target.y()[:, None]).sum() / power.sum()) == pytest.approx(0, abs=1e-9)
