"""The paper's algorithm: its own sampling, and what the area variant repairs."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from benchmarks.accuracy.algorithm1 import Algorithm1, Resampling
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Sensor, Window
from veilcam_optics.transfer.grid import GridLight

SCENE = Scene(14, 14, 0.12, 0.4)
EMBEDDING = Embedding(12, 16)
# The algorithm knows the PSF on the sensor only, so the mask's shadow has to lie within.
SMALL = Camera(window=Window(25, 11, 180, 74), sensor=Sensor(1520, 2028), distance=2e-3)


def weights(camera: Camera, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(camera.mask_shape, generator=generator, dtype=torch.float64)


def pictures(*shape: int) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)


def relative(got: Tensor, wanted: Tensor) -> float:
    return float((got - wanted).norm() / wanted.norm())


def test_grid_is_the_papers() -> None:
    grid = Algorithm1(Camera(), SCENE, EMBEDDING).grid
    assert grid.shape == (380, 507)
    assert float(grid.pitch_y) == pytest.approx(12.4e-6)


def test_area_variant_agrees_with_the_grid_path_and_bilinear_does_not() -> None:
    light = GridLight(SMALL, SCENE, 2)
    mask, scene = weights(SMALL), pictures(3, 14, 14)
    wanted = light.embed(scene, light.psf(mask), EMBEDDING)
    errors = {}
    both: tuple[Resampling, ...] = ("area", "bilinear")
    for resampling in both:
        simulation = Algorithm1(SMALL, SCENE, EMBEDDING, resampling, snr_db=math.inf)
        errors[resampling] = relative(simulation(scene, simulation.psf(mask)), wanted)
    assert errors["area"] < 1e-2
    assert errors["bilinear"] > 4 * errors["area"]


@pytest.mark.parametrize("sensor", [(1208, 1200), (1200, 1208)])
def test_picture_is_not_shifted_at_odd_or_even_sizes(sensor: tuple[int, int]) -> None:
    """150 and 151 samples: all that is symmetric must give a symmetric picture."""
    panel = dataclasses.replace(SMALL.panel, filter_cycle=())
    camera = dataclasses.replace(SMALL, panel=panel, sensor=Sensor(*sensor, 1.55e-6))
    mask = weights(camera)
    mask = mask + mask.flip(0)
    mask = (mask + mask.flip(1)) / 4
    simulation = Algorithm1(camera, SCENE, EMBEDDING, "area", snr_db=math.inf)
    white = torch.ones(1, 14, 14, dtype=torch.float64)
    image = simulation(white, simulation.psf(mask))[0]
    assert relative(image.flip(0), image) < 1e-9
    assert relative(image.flip(1), image) < 1e-9


@pytest.mark.slow
def test_noise_is_as_loud_as_asked_for() -> None:
    scene = pictures(24, 14, 14)
    clean = Algorithm1(SMALL, SCENE, EMBEDDING, snr_db=math.inf)
    psf = clean.psf(weights(SMALL))
    wanted = clean(scene, psf)
    for snr_db in (10.0, 40.0):
        noisy = dataclasses.replace(clean, snr_db=snr_db)
        got = noisy(scene, psf, torch.Generator().manual_seed(3))
        delivered = 10 * math.log10(float(wanted.square().sum() / (got - wanted).square().sum()))
        assert delivered == pytest.approx(snr_db, abs=0.3)
