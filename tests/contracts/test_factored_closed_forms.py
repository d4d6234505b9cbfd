"""Closed forms of diffraction theory, by the factored field and by the transfer operator.

Free-space propagation has its own; here are those that a grid of rectangles can show.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.special import fresnel
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.transfer.factored import aperture_fields
from veilcam_optics.transfer.kernels import Approximation
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach, Variables

from .contracts import relative

WAVELENGTH = 550e-9


def line(low: float, high: float, count: int) -> Tensor:
    return torch.linspace(low, high, count, dtype=torch.float64)


def field(
    points: Tensor,
    centres: list[float],
    width: float,
    distance: float,
    source_distance: float = math.inf,
) -> Tensor:
    return aperture_fields(
        points,
        torch.tensor(centres, dtype=torch.float64),
        width,
        wavelength=WAVELENGTH,
        source_distance=source_distance,
        distance=distance,
    )


@pytest.mark.parametrize("fresnel_number", [0.01, 0.2, 1.0, 5.0, 50.0])
def test_square_aperture_on_axis(fresnel_number: float) -> None:
    """I = 4 (C^2 + S^2)^2 at t = sqrt(2 N) (Goodman, equation 4-36)."""
    distance = 4e-3
    width = 2 * math.sqrt(fresnel_number * WAVELENGTH * distance)
    one_axis = field(line(0, 0, 1), [0.0], width, distance)
    irradiance = (one_axis @ one_axis.mT).abs().square()
    s, c = fresnel(math.sqrt(2 * fresnel_number))
    assert float(irradiance) == pytest.approx(4 * (c**2 + s**2) ** 2, rel=1e-12)


@pytest.mark.parametrize("source_distance", [math.inf, 0.4])
def test_square_aperture_against_quadrature(source_distance: float) -> None:
    """The whole pattern: the Fresnel integral by the midpoint rule on 9 nm."""
    width, distance, y = 180e-6, 4e-3, np.linspace(-4e-4, 4e-4, 41)
    inside = (np.arange(20_000) + 0.5) / 20_000 * width - width / 2
    phase = (y[:, None] - inside) ** 2 / distance + inside**2 / source_distance
    wanted = np.exp(1j * np.pi / WAVELENGTH * phase).sum(1) * width / 20_000
    wanted /= math.sqrt(WAVELENGTH * distance)
    got = field(torch.from_numpy(y), [0.0], width, distance, source_distance)[:, 0]
    # A phase common to all apertures is left out: magnitudes are compared.
    assert relative(got.abs(), torch.from_numpy(np.abs(wanted))) < 5e-7


def test_knife_edge() -> None:
    """A quarter at the edge, 1.370 at t = 1.217, and a shadow without fringes (Born and Wolf)."""
    distance = 4e-3
    unit = math.sqrt(WAVELENGTH * distance / 2)
    t = line(-6, 6, 12_001)
    irradiance = field(t * unit, [0.5], 1.0, distance)[:, 0].abs().square()
    assert float(irradiance[6000]) == pytest.approx(0.25, abs=1e-3)
    assert float(irradiance.max()) == pytest.approx(1.3704, abs=2e-3)
    assert float(t[irradiance.argmax()]) == pytest.approx(1.2172, abs=5e-3)
    s, c = fresnel(t.numpy())
    wanted = torch.from_numpy(((c + 0.5) ** 2 + (s + 0.5) ** 2) / 2)
    assert relative(irradiance, wanted) < 1e-3
    assert bool((irradiance[:6000].diff() > -1e-3).all())


def test_two_slits_in_the_far_field() -> None:
    """Fringes of period lambda z / Delta under a sinc^2, zero in between."""
    width, apart, distance = 60e-6, 219e-6, 20.0
    period = WAVELENGTH * distance / apart
    y = line(-3, 3, 601) * period
    irradiance = field(y, [-apart / 2, apart / 2], width, distance).sum(1).abs().square()
    envelope = torch.sinc(width * y / (WAVELENGTH * distance)).square()
    single = width**2 / (WAVELENGTH * distance)
    wanted = 4 * single * envelope * torch.cos(torch.pi * y / period).square()
    assert relative(irradiance, wanted) < 2e-3
    assert float(irradiance[y.abs().sub(period / 2).abs().argmin()] / irradiance.max()) < 1e-4


@pytest.mark.parametrize("source_distance", [math.inf, 0.4])
def test_shift_equivariance_of_the_field(source_distance: float) -> None:
    """Moving the aperture moves its field by (1 + d2 / d1) as much and changes nothing else."""
    distance, shift = 4e-3, 123.4e-6
    magnified = shift * (1 + distance / source_distance)
    y = line(-5e-4, 5e-4, 101)
    still = field(y, [0.0, 73e-6], 60e-6, distance, source_distance)
    moved = field(y + magnified, [shift, 73e-6 + shift], 60e-6, distance, source_distance)
    assert relative(moved, still) < 1e-10


@pytest.mark.parametrize("source_distance", [math.inf, 0.4])
def test_energy_of_the_field(source_distance: float) -> None:
    """Parseval: what passes an aperture arrives; apertures that do not overlap stay orthogonal."""
    y = line(-0.02, 0.02, 200_001)
    fields = field(y, [-73e-6, 0.0, 73e-6], 60e-6, 4e-3, source_distance)
    gram = fields.mH @ fields * float(y[1] - y[0])
    # Beyond +-20 mm lies lambda z / (pi^2 w y) of it, 2e-4.
    assert relative(gram / 60e-6, torch.eye(3, dtype=torch.complex128)) < 1e-3


def bench(**panel: float) -> Camera:
    return Camera(
        panel=replace(Panel(filter_cycle=()), **panel),  # type: ignore[arg-type]
        window=Window(rows=6, columns=2),
        sensor=Sensor(rows=400, columns=400, pixel=50e-6),
        wavelengths=(WAVELENGTH, WAVELENGTH, WAVELENGTH),
    )


def transfer(camera: Camera, scene: Scene, embedding: Embedding, weights: Tensor) -> Tensor:
    axial = Approximation(axial=True)
    operator = TransferOperator(
        camera, scene, embedding, reach=Reach(5, 1), dtype=torch.float64, approximation=axial
    )
    matrix: Tensor = operator(weights)
    return matrix


@pytest.mark.parametrize("axis", ["y", "x"])
def test_shift_equivariance_of_the_transfer(axis: str) -> None:
    """The mask moved by an embedding pixel's shadow: every row of T moves by one pixel."""
    camera, scene, embedding = bench(), Scene(2, 3, 0.1, 0.4), Embedding(20, 20)
    weights = torch.rand(6, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    shift = torch.tensor(1e-3 / (1 + camera.distance / scene.distance), dtype=torch.float64)
    still = transfer(camera, scene, embedding, weights).reshape(6, 20, 20)
    operator = TransferOperator(
        camera,
        scene,
        embedding,
        reach=Reach(5, 1),
        dtype=torch.float64,
        approximation=Approximation(axial=True),
        variables=Variables(shift_y=shift) if axis == "y" else Variables(shift_x=shift),
    )
    moved = operator(weights).reshape(6, 20, 20)
    if axis == "y":
        moved, still = moved[:, 1:], still[:, :-1]
    else:
        moved, still = moved[..., 1:], still[..., :-1]
    assert relative(moved, still) < 1e-3


def test_scene_pixel_further_is_an_embedding_pixel_back() -> None:
    """Where a scene pixel's image is one embedding pixel, T is Toeplitz along both axes."""
    camera, embedding = bench(), Embedding(20, 20)
    scene = Scene(rows=5, columns=5, height=5 * 1e-3 * 100, distance=0.4)
    assert scene.pixel_at_sensor(camera) == pytest.approx(1e-3)
    weights = torch.rand(6, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    matrix = transfer(camera, scene, embedding, weights).reshape(5, 5, 20, 20)
    # Up in the scene is down on the sensor.
    assert relative(matrix[1:, :, :-1], matrix[:-1, :, 1:]) < 1e-10
    assert relative(matrix[:, 1:, :, :-1], matrix[:, :-1, :, 1:]) < 1e-10


def test_energy_of_the_transfer() -> None:
    """A white scene: the sum over the pixels is the power that the open areas let through."""
    camera, scene = bench(), Scene(rows=3, columns=3, height=0.1, distance=0.4)
    weights = torch.rand(6, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    matrix = transfer(camera, scene, Embedding(4, 4), weights)
    power = weights.square().sum() * camera.panel.aperture_y * camera.panel.aperture_x
    got = matrix.sum() * camera.sensor.height * camera.sensor.width / 16
    # Off the sensor, 20 mm wide, goes lambda z / (pi^2 w 10 mm), once along each axis: 5e-4.
    assert float(got / power) == pytest.approx(1, abs=2e-3)
