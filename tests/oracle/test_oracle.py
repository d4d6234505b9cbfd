"""The oracle against closed forms, and plans against the oracle."""

from __future__ import annotations

import math

import numpy as np
import pytest

from .physics import Axis, Beam, Light, transfer
from .run import figures_of, judge

WAVELENGTH = 0.5e-6
FAR = 1e3


def hole(width: float, distance: float, *, sensor: float, pixels: int) -> Light:
    """One square hole, one scene point far away."""
    axis = Axis(1, width, 1, 1, sensor, pixels, 1, 1e-6)
    return Light(axis, axis, distance, (Beam(0, WAVELENGTH, FAR, 1.0),))


def test_far_field_of_a_square_hole() -> None:
    """Fraunhofer: (a^2 / lambda d)^2 sinc^2 sinc^2 (Goodman, equation 4-28)."""
    width, distance, pixels = 10e-6, 20e-3, 9
    sensor = 2 * WAVELENGTH * distance / width
    found = transfer(hole(width, distance, sensor=sensor, pixels=pixels), np.ones((1, 3, 1, 1)))
    at = (np.arange(pixels * 40) + 0.5) / (pixels * 40) * sensor - sensor / 2
    line = (np.sinc(width * at / (WAVELENGTH * distance)) ** 2).reshape(pixels, 40).mean(1)
    wanted = (width**2 / (WAVELENGTH * distance)) ** 2 * np.outer(line, line)
    # Angles reach 0.05 rad, whose square is what Fraunhofer leaves out.
    assert np.abs(found.reshape(pixels, pixels) - wanted).max() < 5e-3 * wanted.max()


def test_all_light_of_a_hole_arrives() -> None:
    """Energy: a sensor far wider than the beam collects what the hole lets through."""
    width, distance, sensor = 20e-6, 100e-6, 200e-6
    found = transfer(hole(width, distance, sensor=sensor, pixels=1), np.ones((1, 3, 1, 1)))
    assert float(found.sum()) * sensor**2 == pytest.approx(width**2, rel=1e-2)


def test_near_a_large_hole_light_is_its_shadow() -> None:
    """Fresnel number 500: what an edge blurs is a few per cent of a pixel."""
    width, distance = 50e-6, 10e-6
    found = transfer(hole(width, distance, sensor=2 * width, pixels=4), np.ones((1, 3, 1, 1)))
    wanted = np.outer([0, 1, 1, 0], [0, 1, 1, 0])
    assert np.abs(found.reshape(4, 4) - wanted).max() < 5e-2


def test_a_scene_at_an_angle_is_fainter_by_the_fourth_power_of_its_cosine() -> None:
    """Lambert, the tilted plane, and the distance; the sensor sees all of the hole's light."""
    wide = Axis(1, 20e-6, 1, 1, 200e-6, 1, 1, 1e-6)
    steep = Axis(1, 20e-6, 1, 1, 200e-6, 1, 3, 0.25)
    light = Light(steep, wide, 40e-6, (Beam(0, WAVELENGTH, 1.0, 1.0),))
    found = transfer(light, np.ones((1, 3, 1, 1)))[0, :, 0]
    assert found[0] / found[1] == pytest.approx(math.cos(math.atan(0.25)) ** 4, rel=2e-2)


def test_finer_cells_change_nothing() -> None:
    axis = Axis(3, 12e-6, 3, 5, 40e-6, 4, 2, 1e-3)
    light = Light(axis, axis, 1e-3, (Beam(0, WAVELENGTH, 0.3, 1.0),), rotation=0.02)
    amplitudes = np.random.default_rng(0).random((1, 3, 3, 3))
    coarse, fine = (transfer(light, amplitudes, finer=finer) for finer in (1, 2))
    assert np.linalg.norm(coarse - fine) < 5e-3 * np.linalg.norm(fine)


@pytest.mark.slow
def test_forty_plans_are_honest() -> None:
    """Of the command's thousand the first forty; one of them is at a grid's expense."""
    found = figures_of(judge(seed) for seed in range(40))
    assert found["oracle_honest_fraction"] >= 0.92
    assert found["oracle_worst_reached_ratio"] <= 3
    assert found["oracle_unjudged_fraction"] <= 0.1
