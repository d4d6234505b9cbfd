"""Measurements: counted photons, saturation, offset and rounding."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from tests.contracts.setting import measurement_model
from tests.unit.optics.tensors import seeded
from torch import Tensor

from veilcam_optics.camera.imperfections import Conditions
from veilcam_optics.effects.composition import read
from veilcam_optics.effects.sensor import over_light
from veilcam_optics.plan.errors import converted


def test_measurement_passes_gradients_straight_through() -> None:
    values = torch.rand(2, 9, dtype=torch.float64, requires_grad=True)
    conditions = Conditions(electrons=1e3, read_noise=2.0, adc_bits=8, adc_range=2.0)
    measurements_ = read(measurement_model(conditions), values, seeded(0))
    (gradient,) = torch.autograd.grad(measurements_.sum(), values)
    assert torch.allclose(gradient, torch.ones_like(gradient))


def test_part_of_the_light_is_that_of_each_mask() -> None:
    """One mask in two leaves hardly any light: what is added is a thousand times as much there."""
    values = torch.stack([torch.ones(2, 3), torch.full((2, 3), 1e-3), torch.zeros(2, 3)]).double()
    added = torch.tensor(0.01, dtype=torch.float64)
    assert over_light(added, values) == pytest.approx(math.sqrt((0.01**2 + 10**2) / 2))
    assert over_light(added, values[2:]) == 1.0


def test_errors_below_half_a_step_are_not_made_much_of() -> None:
    """Far below it reads nothing whatever its error is; a little below, an error may lift it."""
    conditions = Conditions(adc_bits=4, adc_range=15.0)
    bright = torch.linspace(1, 9, 12, dtype=torch.float64).reshape(1, 3, 4)
    for faint, most in ((0.05, 1.2), (0.496, 20.0)):
        values = torch.cat((bright, torch.full_like(bright, faint)))
        alone = converted(0.01, values[:1], conditions, 12)
        both = converted(0.01, values, conditions, 12)
        assert both < most * alone
    assert both > 1.2 * alone


def test_every_setting_changes_the_measurements() -> None:
    values = torch.rand(50, 50, generator=seeded(5)) * 1.2
    base = Conditions(
        electrons=8000.0, read_noise=3.0, full_well=8000.0, adc_bits=12, black_level=0.06
    )

    def measurements(conditions: Conditions, *, shot: bool = True) -> Tensor:
        generator = seeded(0)
        return read(measurement_model(conditions, shot=shot), values, generator)

    first = measurements(base)
    changes = {"electrons": 4e3, "read_noise": 30.0, "full_well": 4e3, "adc_bits": 10}
    for name, value in {**changes, "adc_range": 0.5, "black_level": 0.0}.items():
        changed = dataclasses.replace(base, **{name: value})  # type: ignore[arg-type]
        assert not torch.equal(measurements(changed), first), name
    assert not torch.equal(measurements(base, shot=False), first)
    assert torch.equal(measurements(base), first)
