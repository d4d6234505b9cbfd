"""Propagators of the accuracy chart against closed forms and against each other."""

from __future__ import annotations

import math

import pytest
import torch
from benchmarks.accuracy.fresnel import FresnelImpulse, FresnelTransfer
from benchmarks.accuracy.geometric import GeometricShadow
from benchmarks.accuracy.rayleigh_sommerfeld import RayleighSommerfeld

from veilcam_optics.propagation import Propagator
from veilcam_optics.propagation.sampling import Grid

WAVELENGTH, WAIST = 550e-9, 20e-6
RAYLEIGH = math.pi * WAIST**2 / WAVELENGTH


def gaussian(grid: Grid, z: float) -> torch.Tensor:
    """Waist, curvature and Gouy phase of a beam (Siegman, Lasers, chapter 17)."""
    squared = grid.y().square()[:, None] + grid.x().square()
    q = 1 + 1j * z / RAYLEIGH
    return torch.exp(-squared / (WAIST**2 * q)) / q


@pytest.mark.parametrize(
    ("method", "rayleigh_ranges"),
    [
        (FresnelTransfer(), 0.2),
        (FresnelTransfer(guard=1), 1.0),
        (FresnelImpulse(), 2.0),
        (FresnelImpulse(), 3.0),
        (RayleighSommerfeld(), 1.0),
    ],
    ids=repr,
)
@pytest.mark.parametrize("pitch", [3.6e-6, 3e-6], ids=["same pitch", "other pitch"])
def test_gaussian_beam_arrives_as_its_closed_form(
    method: Propagator, rayleigh_ranges: float, pitch: float
) -> None:
    distance = RAYLEIGH * rayleigh_ranges
    source = Grid.square(40, 41, 3.6e-6)
    target = Grid(40, 38, pitch, pitch, centre_x=4e-6)
    assert method.supports(source, target, distance, WAVELENGTH)
    got = method.prepare(source, target, distance, WAVELENGTH)(gaussian(source, 0))
    wanted = gaussian(target, distance)
    assert float((got - wanted).norm() / wanted.norm()) < 3e-3


def test_shadow_is_magnified_from_its_point_whatever_the_phase() -> None:
    source, target = Grid.square(100, 100, 1e-6), Grid.square(300, 300, 1e-6)
    field = torch.full((100, 100), 1j, dtype=torch.complex128)
    shadow = GeometricShadow(source_distance=5e-3).prepare(source, target, 5e-3, WAVELENGTH)(field)
    assert int((shadow.abs() > 0)[150].sum()) == 200
    assert float(shadow.abs().max()) == pytest.approx(0.5)
    assert float(shadow.norm() / field.norm()) == pytest.approx(1, rel=1e-12)
