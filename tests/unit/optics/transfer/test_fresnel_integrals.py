"""Fresnel integrals in NumPy: against many digits, and where their polynomials come from."""

from __future__ import annotations

import mpmath  # type: ignore[import-untyped]
import numpy as np
import pytest
import torch

from veilcam_optics.transfer import fresnel_integrals as module
from veilcam_optics.transfer.factored import fresnel_integral
from veilcam_optics.transfer.fresnel_integrals import fresnel_integrals

UNIT = 2.0**-53


def auxiliary(t: mpmath.mpf) -> tuple[mpmath.mpf, mpmath.mpf]:
    """f and g (DLMF 7.2.10 and 7.2.11)."""
    phase, half = mpmath.pi * t**2 / 2, mpmath.mpf(1) / 2
    left_c, left_s = half - mpmath.fresnelc(t), half - mpmath.fresnels(t)
    sine, cosine = mpmath.sin(phase), mpmath.cos(phase)
    return left_s * cosine - left_c * sine, left_c * cosine + left_s * sine


def test_polynomials_interpolate_at_chebyshev_nodes() -> None:
    with mpmath.workdps(50):
        bend, far, count = mpmath.mpf(module._BEND), mpmath.mpf(module._FAR), len(module._NEAR_F)
        last = (far - bend) / (far + bend)
        nodes = [mpmath.cos(mpmath.pi * (2 * k + 1) / (2 * count)) for k in range(count)]
        places = [(last + 1) / 2 * (node + 1) - 1 for node in nodes]
        values = [auxiliary(bend * (1 + place) / (1 - place)) for place in places]
        powers = mpmath.matrix([[node**k for k in range(count)] for node in nodes])
        for which, stored in enumerate((module._NEAR_F, module._NEAR_G)):
            wanted = mpmath.lu_solve(powers, mpmath.matrix([value[which] for value in values]))
            assert [float(coefficient) for coefficient in wanted] == list(stored)


@pytest.mark.parametrize("largest", [1.0, 8.0, 100.0])
def test_integrals_to_many_digits(largest: float) -> None:
    t = np.linspace(-largest, largest, 301)
    found = np.stack(fresnel_integrals(t))
    wanted = np.array([[float(of(x)) for x in t] for of in (mpmath.fresnelc, mpmath.fresnels)])
    # The phase is rounded: half a unit of pi t^2 / 2, over the pi t of f; and sums of order one.
    assert (np.abs(found - wanted) <= UNIT * (np.abs(t) + 8)).all()


def test_both_libraries_give_the_same() -> None:
    t = np.linspace(-40, 40, 4002).reshape(-1, 3, 1)[:, ::-1]
    found, same = fresnel_integral(t), fresnel_integral(torch.from_numpy(t.copy())).numpy()
    assert found.dtype == same.dtype == np.complex128
    # Sines of either library are off by a unit or two.
    assert np.abs(found - same).max() <= 4 * UNIT


def test_ends() -> None:
    t = np.array([0.0, -0.0, np.inf, -np.inf])
    assert fresnel_integral(t).tolist() == [0, 0, 0.5 + 0.5j, -0.5 - 0.5j]
    assert fresnel_integral(t[:0].reshape(0, 3)).shape == (0, 3)
