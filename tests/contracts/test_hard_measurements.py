"""Measurements at the ends of the range: saturated sensors, single photons, all sorts of noise."""

from __future__ import annotations

import math

import pytest
import torch
from tests.unit.optics.tensors import seeded
from torch import Tensor

from veilcam_optics.camera.imperfections import Conditions
from veilcam_optics.effects.composition import read
from veilcam_optics.sensor.noise import shot_noise

from .setting import measurement_model


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("electrons", [1e5, 1e12, 1e18, 1e30])
def test_saturated_sensor(electrons: float, dtype: torch.dtype) -> None:
    """Every pixel reads a full well, and the converter its largest number."""
    conditions = Conditions(electrons=8000.0, full_well=8000.0, adc_bits=12, read_noise=3.0)
    values = torch.full((20, 20), electrons / 8000.0, dtype=dtype)
    assert torch.equal(
        read(measurement_model(conditions), values, seeded()), torch.ones_like(values)
    )


def test_around_the_full_well() -> None:
    """Measurements rise up to the full well and stay there."""
    conditions = Conditions(electrons=1e4, full_well=8e3, adc_bits=12, adc_range=1.0)
    values = torch.linspace(0, 1.6, 4001, dtype=torch.float64)
    measurements = read(measurement_model(conditions, shot=False), values)
    assert bool((measurements.diff() >= 0).all())
    assert float(measurements[0]) == 0
    # Half a step of the converter is the most that rounding moves a measurement.
    assert float((measurements - values.clamp_max(0.8)).abs().max()) <= 0.5 / 4095 + 1e-9


def test_saturated_embedding() -> None:
    """A value is clipped at its full well, and has no gradient there."""
    conditions = Conditions(electrons=1000.0, full_well=500.0, adc_bits=8)
    values = torch.tensor([[0.1, 0.49, 0.51, 1e6]], dtype=torch.float64, requires_grad=True)
    measurement = read(measurement_model(conditions, shot=False), values)
    assert torch.allclose(
        measurement.detach(), torch.tensor([[0.1, 0.49, 0.5, 0.5]]).double(), atol=1e-3
    )
    (gradient,) = torch.autograd.grad(measurement.sum(), values)
    assert gradient.tolist() == [[1, 1, 0, 0]]


@pytest.mark.parametrize("mean", [0.0, 1.0, 1 / 784])
def test_one_photon(mean: float) -> None:
    """A photon in each pixel, or in a whole image: mean and variance are those of both noises."""
    conditions = Conditions(
        electrons=1000.0,
        full_well=1000.0,
        read_noise=2.0,
        adc_bits=14,
        adc_range=2.0,
        black_level=1,
    )
    count = 400_000
    values = torch.full((count,), mean / 1000, dtype=torch.float64)
    electrons = (read(measurement_model(conditions), values, seeded()) - 1) * 1000
    variance = mean + 2.0**2 + (2000 / (2**14 - 1)) ** 2 / 12
    assert float(electrons.mean()) == pytest.approx(mean, abs=5 * math.sqrt(variance / count))
    assert float(electrons.var()) == pytest.approx(variance, rel=5 * math.sqrt(2 / count) + 1e-3)
    assert bool((electrons < 0).any())


def test_one_photon_embedding() -> None:
    """An all-white scene that gives one electron per embedding value: whole numbers of them."""
    values = torch.full((500, 24, 32), 1.0, dtype=torch.float64)
    measurement = read(measurement_model(Conditions(electrons=1.0)), values, seeded())
    assert torch.equal(measurement, measurement.round())
    assert float(measurement.mean()) == pytest.approx(1, abs=0.01)
    assert float(measurement.var()) == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("snr_db", [-40.0, 0.0, 120.0])
@pytest.mark.parametrize("level", [1e-15, 1.0, 1e15])
def test_noise_far_above_and_below_the_signal(
    snr_db: float, level: float, dtype: torch.dtype
) -> None:
    """From ten thousand times the signal's power to a millionth of a millionth of it."""
    values = torch.rand(50, 24, 32, generator=seeded(), dtype=torch.float64).to(dtype) * level
    noise = (shot_noise(values, snr_db, seeded(1)) - values).double()
    delivered = 10 * torch.log10(values.double().square().sum() / noise.square().sum())
    # 120 dB is below what float32 can add.
    if dtype == torch.float64 or snr_db < 100:
        assert float(delivered) == pytest.approx(snr_db, abs=0.1)
    assert bool(torch.isfinite(noise).all())


def test_each_image_has_its_own_noise_level() -> None:
    """A bright neighbour in the batch changes nothing: 60 dB apart, both get their 30 dB."""
    values: Tensor = torch.rand(2, 300, 300, generator=seeded(), dtype=torch.float64)
    values[1] *= 1e3
    noise = shot_noise(values, 30.0, seeded(1)) - values
    delivered = 10 * torch.log10(values.square().sum((1, 2)) / noise.square().sum((1, 2)))
    assert delivered.tolist() == pytest.approx([30.0, 30.0], abs=0.1)
