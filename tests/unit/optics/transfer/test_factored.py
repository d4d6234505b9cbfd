"""Fresnel integrals: against scipy's, near zero and far from it."""

from __future__ import annotations

import math

import pytest
import torch
from scipy.special import fresnel

from veilcam_optics.transfer.factored import fresnel_integral

ROUNDING = 2.0**-53


@pytest.mark.parametrize("largest", [1.0, 7.99, 8.01, 30.0, 300.0, 1e4])
def test_integrals_are_scipys_to_rounding(largest: float) -> None:
    # More than are taken at once, on both sides of zero, and of where the series begins.
    t = torch.linspace(-largest, largest, 40_001, dtype=torch.float64).reshape(-1, 13, 17, 181)
    found = fresnel_integral(t)
    sine, cosine = (torch.from_numpy(value) for value in fresnel(t.numpy()))
    # Each rounds the phase pi t^2 / 2 and, to a unit or so, what it multiplies by 1 / (pi t): at
    # most t / 2 units either way. Sums of order one add some units of their own.
    bound = ROUNDING * (t.abs() + 8)
    assert bool(((found.real - cosine).abs() <= bound).all())
    assert bool(((found.imag - sine).abs() <= bound).all())


def test_integrals_are_odd_and_end_at_a_half() -> None:
    t = torch.tensor([0.0, 0.5, 8.0, 1e3, 1e7, math.inf], dtype=torch.float64)
    assert torch.equal(fresnel_integral(-t), -fresnel_integral(t))
    assert fresnel_integral(t)[0] == 0
    assert fresnel_integral(t)[5] == 0.5 + 0.5j
    off = (fresnel_integral(t)[3:] - (0.5 + 0.5j)).abs()
    assert off[:2].tolist() == pytest.approx([1 / (math.pi * 1e3), 1 / (math.pi * 1e7)], rel=1e-3)


def test_no_argument_and_one() -> None:
    assert fresnel_integral(torch.zeros(0, 3, dtype=torch.float64)).shape == (0, 3)
    assert fresnel_integral(torch.tensor(9.0, dtype=torch.float64)).shape == ()
