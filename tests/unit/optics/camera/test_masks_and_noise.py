"""Masks the panel can show, and noise with the ratio asked for."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from tests.unit.optics.tensors import seeded

from veilcam_optics.camera.geometry import Camera, Panel
from veilcam_optics.camera.masks import quantise, random_mask, to_levels, to_weights
from veilcam_optics.errors import OpticsError
from veilcam_optics.sensor.noise import shot_noise


def test_random_mask_follows_its_seed() -> None:
    one, same, other = (random_mask(Camera(), seeded(seed)) for seed in (1, 1, 2))
    assert one.equal(same)
    assert not one.equal(other)
    assert 0 <= float(one.min()) <= float(one.max()) <= 1


def test_levels_and_weights_are_inverse() -> None:
    levels = np.arange(64, dtype=np.uint8)
    assert np.array_equal(to_levels(to_weights(levels, Panel()), Panel()), levels)
    with pytest.raises(OpticsError, match="0 to 63"):
        to_weights(np.array([64], dtype=np.uint8), Panel())


def test_quantise_shows_levels_and_passes_the_gradient() -> None:
    weights = torch.rand(51, 22, generator=seeded(0)).requires_grad_()
    shown = quantise(weights, Panel())
    assert torch.allclose(shown * 63, (shown * 63).round(), atol=1e-5)
    shown.sum().backward()  # type: ignore[no-untyped-call]
    assert weights.grad is not None
    assert weights.grad.eq(1).all()


def test_noise_grows_with_the_signal() -> None:
    values = torch.cat([torch.full((1, 5000), 1.0), torch.full((1, 5000), 9.0)], dim=1)
    noise = shot_noise(values, 20.0, seeded(0)) - values
    ratio = float(noise[0, 5000:].std() / noise[0, :5000].std())
    assert abs(ratio - 3) < 0.15


def test_no_light_no_batch_no_noise() -> None:
    assert shot_noise(torch.zeros(2, 3, 4), 40.0).eq(0).all()
    assert shot_noise(torch.zeros(0, 3, 4), 40.0).shape == (0, 3, 4)
    values = torch.rand(2, 3)
    assert shot_noise(values, math.inf).equal(values)
    with pytest.raises(OpticsError, match="snr_db"):
        shot_noise(values, math.nan)


def test_gradient_knows_of_the_noises_amplitude() -> None:
    values = torch.rand(3, 8, dtype=torch.float64, generator=seeded(4)) + 0.1

    def noisy(lit: torch.Tensor) -> torch.Tensor:
        return shot_noise(lit, 20.0, seeded(5))

    assert torch.autograd.gradcheck(noisy, (values.requires_grad_(),))
    # In darkness there is no slope, and no NaN either.
    for dark in (torch.zeros(2, 8), torch.eye(2, 8)):
        noisy(dark.requires_grad_()).sum().backward()  # type: ignore[no-untyped-call]
        assert dark.grad is not None
        assert bool(torch.isfinite(dark.grad).all())
