"""From irradiance to readings: colours by exact shares, counted photons, saturation, rounding."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Embedding, Sensor
from veilcam_optics.camera.imperfections import Conditions
from veilcam_optics.sensor.readout import bayer_shares, read


def mosaic(planes: Tensor) -> Tensor:
    """What an RGGB sensor sees of (3, rows, columns): one colour at every pixel."""
    seen = planes[1].clone()
    seen[0::2, 0::2] = planes[0, 0::2, 0::2]
    seen[1::2, 1::2] = planes[2, 1::2, 1::2]
    return seen


@pytest.mark.parametrize("shape", [(1, 1), (3, 4), (7, 5), (13, 10)])
def test_bayer_shares_are_those_of_a_mosaic(shape: tuple[int, int]) -> None:
    """Averages over embedding pixels, cut where sensor pixels are cut, of what a mosaic sees."""
    sensor = Sensor(rows=13, columns=10)
    shares = bayer_shares(sensor, Embedding(*shape))

    def cover(pixels: int, parts: int) -> Tensor:
        edges = torch.arange(parts + 1, dtype=torch.float64) * pixels / parts
        index = torch.arange(pixels, dtype=torch.float64)
        upper = torch.minimum(edges[1:, None], index + 1)
        lower = torch.maximum(edges[:-1, None], index)
        return (upper - lower).clamp_min(0) * parts / pixels

    for channel in range(3):
        planes = torch.zeros(3, 13, 10, dtype=torch.float64)
        planes[channel] = 1
        seen = cover(13, shape[0]) @ mosaic(planes) @ cover(10, shape[1]).T
        assert torch.allclose(shares[channel], seen)


def test_counted_photons_have_the_variance_of_their_mean() -> None:
    values = torch.full((1, 200_000), 0.02, dtype=torch.float64)
    counted = read(values, Conditions(electrons=500.0), generator=torch.Generator().manual_seed(0))
    electrons = counted * 500
    assert float(electrons.mean()) == pytest.approx(10, rel=0.01)
    assert float(electrons.var()) == pytest.approx(10, rel=0.02)
    assert float((electrons - electrons.round()).abs().max()) < 1e-9
    quiet = read(values, Conditions(electrons=500.0), shot=False)
    assert torch.allclose(quiet, values)


def test_readings_are_noisy_saturate_and_are_rounded() -> None:
    values = torch.linspace(0, 1, 4001, dtype=torch.float64)[None]
    generator = torch.Generator().manual_seed(0)
    noisy = read(values, Conditions(electrons=1e4, read_noise=50), shot=False, generator=generator)
    assert float((noisy - values).std()) == pytest.approx(50 / 1e4, rel=0.05)
    full = read(values, Conditions(electrons=1e4, full_well=3e3), shot=False)
    assert float(full.max()) == pytest.approx(0.3)
    rounded = read(values, Conditions(adc_bits=3, black_level=0.1))
    assert len(set(rounded.flatten().tolist())) == 7  # 0.1 is above the lowest of eight
    assert float(rounded.max()) == 1
    assert torch.allclose(read(values, Conditions(black_level=0.1)), values + 0.1)


def test_reading_passes_gradients_straight_through() -> None:
    values = torch.rand(2, 9, dtype=torch.float64, requires_grad=True)
    conditions = Conditions(electrons=1e3, read_noise=2.0, adc_bits=8, adc_range=2.0)
    readings_ = read(values, conditions, generator=torch.Generator().manual_seed(0))
    (gradient,) = torch.autograd.grad(readings_.sum(), values)
    assert torch.allclose(gradient, torch.ones_like(gradient))


def test_every_setting_changes_the_readings() -> None:
    values = torch.rand(50, 50, generator=torch.Generator().manual_seed(5)) * 1.2
    base = Conditions(
        electrons=8000.0, read_noise=3.0, full_well=8000.0, adc_bits=12, black_level=0.06
    )

    def readings(conditions: Conditions, *, shot: bool = True) -> Tensor:
        generator = torch.Generator().manual_seed(0)
        return read(values, conditions, shot=shot, generator=generator)

    first = readings(base)
    changes: list[dict[str, Any]] = [
        {"electrons": 4000.0},
        {"read_noise": 30.0},
        {"full_well": 4000.0},
        {"adc_bits": 10},
        {"adc_range": 0.5},
        {"black_level": 0.0},
    ]
    for change in changes:
        assert not torch.equal(readings(dataclasses.replace(base, **change)), first), change
    assert not torch.equal(readings(base, shot=False), first)
    assert torch.equal(readings(base), first)


def test_one_photon_in_a_hundred_pixels() -> None:
    values = torch.full((1, 300, 300), 0.01)
    faint = read(values, Conditions(electrons=1.0), generator=torch.Generator().manual_seed(0))
    # 90000 pixels: a tenth is three standard deviations of the number of lit ones.
    assert float((faint > 0).double().mean()) == pytest.approx(1 - math.exp(-0.01), rel=0.1)
