"""Sensors by name, and from electrons to digital numbers."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
import torch

from veilcam_optics.camera.geometry import Sensor
from veilcam_optics.camera.sensors import SENSORS, generic_sensor, sensor_model
from veilcam_optics.errors import OpticsError
from veilcam_optics.propagation.sampling import area_average
from veilcam_optics.sensor.photons import Readout, mosaic, split_mosaic


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_the_default_sensor_is_the_hq_camera() -> None:
    assert sensor_model("HQ").sensor == Sensor()
    assert sensor_model("HQ").sensor.height == pytest.approx(4.712e-3)


@pytest.mark.parametrize("name", list(SENSORS))
def test_every_sensor_has_a_diagonal_of_a_real_one(name: str) -> None:
    model = sensor_model(name)
    diagonal = math.hypot(model.sensor.height, model.sensor.width)
    # From the makers: 7.857, 6.3, 4.60 and 7.4 mm.
    wanted = {"HQ": 7.857e-3, "GS": 6.3e-3, "V2": 4.6e-3, "V3": 7.4e-3}[name]
    assert diagonal == pytest.approx(wanted, rel=0.01)
    assert 0 < model.black_level < 2**model.sensor.bit_depth


def test_unknown_and_impossible_sensors_are_refused() -> None:
    with pytest.raises(OpticsError, match="HQ, GS, V2, V3"):
        sensor_model("HD")
    with pytest.raises(OpticsError, match=r"sensor\.pixel"):
        generic_sensor(10, 10, -1e-6)
    with pytest.raises(OpticsError, match="black_level"):
        generic_sensor(10, 10, 1e-6, 8, black_level=256)
    assert not generic_sensor(10, 20, 1e-6).colour


def test_shot_noise_has_the_variance_of_its_mean() -> None:
    readout = Readout(full_well=65535, read_noise=0, bit_depth=16, black_level=0)
    for mean in (4.0, 400.0, 40000.0):
        numbers = readout.read(torch.full((400, 400), mean), seeded())
        counted = readout.electrons(numbers)
        assert float(counted.mean()) == pytest.approx(mean, rel=0.01)
        # One number per electron: the converter adds nothing of its own.
        assert float(counted.var()) == pytest.approx(mean, rel=0.02)


def test_read_noise_and_black_level_in_the_dark() -> None:
    readout = Readout(read_noise=5.0, shot_noise=False)
    numbers = readout.read(torch.zeros(500, 500), seeded())
    assert float(numbers.double().mean()) == pytest.approx(256, abs=0.02)
    assert float(readout.electrons(numbers).std()) == pytest.approx(5.0, rel=0.02)
    cut = dataclasses.replace(readout, black_level=0).read(torch.zeros(500, 500), seeded())
    assert float(cut.double().mean()) > 0.3  # what a black level of zero would do: half is lost


def test_saturation_and_one_photon() -> None:
    readout = Readout(read_noise=0)
    for electrons in (8000.0, 1e6, 1e18):
        numbers = readout.read(torch.full((4, 4), electrons * 1.5), seeded())
        assert int(numbers.min()) == readout.white_level == 4095
        assert bool(readout.saturated(numbers).all())
    # The well is full before the converter reads it: half of the readings fall below the top.
    full = Readout(read_noise=50.0).read(torch.full((200, 200), 1e6), seeded())
    assert float((full < 4095).double().mean()) == pytest.approx(0.5, abs=0.03)
    faint = Readout(full_well=100, read_noise=0, black_level=0).read(
        torch.full((300, 300), 0.01), seeded()
    )
    assert float((faint > 0).double().mean()) == pytest.approx(1 - math.exp(-0.01), rel=0.1)


def test_every_setting_changes_the_numbers() -> None:
    light = torch.rand(50, 50, generator=seeded(5)) * 9000
    base = Readout()
    first = base.read(light, seeded())
    changes: list[dict[str, Any]] = [
        {"full_well": 4000.0},
        {"read_noise": 30.0},
        {"bit_depth": 10},
        {"black_level": 0},
        {"shot_noise": False},
    ]
    for change in changes:
        other = dataclasses.replace(base, **change)
        assert not torch.equal(other.read(light, seeded()), first), change
    assert torch.equal(base.read(light, seeded()), first)
    assert first.dtype == torch.int32


def test_impossible_readouts_are_refused() -> None:
    for change, name in (
        ({"full_well": 0.0}, "full_well"),
        ({"read_noise": -1.0}, "read_noise"),
        ({"read_noise": math.nan}, "read_noise"),
        ({"bit_depth": 0}, "bit_depth"),
        ({"black_level": 4095}, "black_level"),
    ):
        with pytest.raises(OpticsError, match=name):
            dataclasses.replace(Readout(), **change)
    for bad in (-1.0, math.nan):
        with pytest.raises(OpticsError, match="electrons holds"):
            Readout().read(torch.tensor([bad]))


@pytest.mark.parametrize("shape", [(4, 6), (5, 7), (1, 3)])
def test_mosaic_keeps_each_pixels_own_channel(shape: tuple[int, int]) -> None:
    planes = torch.arange(3.0)[:, None, None].expand(3, *shape)
    seen = mosaic(planes)
    assert seen.shape == shape
    assert seen[0, 0] == 0
    assert seen[0, 1] == 1
    parts = split_mosaic(seen)
    assert all(bool((part == channel).all()) for channel, found in parts.items() for part in found)
    assert len(parts[1]) == 2


def test_binning_the_mosaic_weighs_green_twice() -> None:
    planes = torch.rand(3, 40, 60, generator=seeded(), dtype=torch.float64).mean((1, 2))
    raw = mosaic(planes[:, None, None].expand(3, 40, 60))
    shares = torch.tensor(Sensor().channel_weights, dtype=torch.float64)
    assert torch.allclose(area_average(raw, 4, 5), (shares * planes).sum(), atol=1e-12)


def test_mosaic_refuses_other_shapes_and_patterns() -> None:
    with pytest.raises(OpticsError, match=r"planes\.shape"):
        mosaic(torch.zeros(4, 4))
    with pytest.raises(OpticsError, match="pattern"):
        mosaic(torch.zeros(3, 4, 4), ((0, 1), (1, 3)))


@pytest.mark.parametrize(("n", "boxes"), [(10, 5), (10, 3), (7, 7), (3, 8), (1, 1), (507, 32)])
def test_area_average_is_exact(n: int, boxes: int) -> None:
    values = torch.rand(2, n, 4, generator=seeded(), dtype=torch.float64)
    got = area_average(values, boxes, 4)
    assert torch.allclose(got.mean((1, 2)), values.mean((1, 2)), atol=1e-13)
    # The same by repeating every sample: whole numbers of them then fill every box.
    fine = values.repeat_interleave(boxes, dim=1).reshape(2, boxes, n, 4).mean(2)
    assert torch.allclose(got, fine, atol=1e-13)
