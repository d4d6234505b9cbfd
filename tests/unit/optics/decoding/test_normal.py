"""Normal numbers from uniform ones: exact to rounding, and finite for every word."""

from __future__ import annotations

import numpy as np
import pytest
from mpmath import erfinv, mp, mpf  # type: ignore[import-untyped]
from scipy.special import ndtri
from scipy.stats import kstest

from veilcam_optics.decoding.normal import inverse_normal, normal


def test_is_the_inverse_of_the_distribution() -> None:
    """Against 40 digits, on both sides of every seam of the three quotients."""
    with mp.workdps(40):
        tail = float(mp.exp(-25))
        probabilities = [
            *(2.0**-k for k in range(1, 55)),
            *(0.075 * (1 + shift) for shift in (-1e-12, 0, 1e-12)),
            *(tail * (1 + shift) for shift in (-1e-12, 0, 1e-12)),
            *(0.5 + shift for shift in (-1e-9, 1e-9, 1e-3)),
        ]
        probabilities += [1 - p for p in probabilities if 1 - p < 1]
        found = inverse_normal(np.array(probabilities))
        wanted = np.array([float(mp.sqrt(2) * erfinv(2 * mpf(p) - 1)) for p in probabilities])
    # Two polynomials of eight terms that have one sign each, a quotient and what it is taken at:
    # some ten roundings.
    assert np.abs(found - wanted).max() <= 10 * 2.0**-53 * np.abs(wanted).max()
    assert (np.abs(found - wanted) <= 10 * 2.0**-53 * np.abs(wanted)).all()


def test_numbers_are_those_that_were_drawn_before_scipy_was_left() -> None:
    drawn = np.random.default_rng(0).integers(0, 256, 8 * 100_000, np.uint8)
    words = drawn.view("<u8") >> np.uint64(11)
    wanted = ndtri((words + 0.5) * 2.0**-53)
    assert np.allclose(normal(drawn), wanted, rtol=1e-14, atol=1e-16)
    assert kstest(normal(drawn), "norm").pvalue > 1e-6


@pytest.mark.parametrize("shape", [(0,), (1,), (3, 4)])
def test_any_shape(shape: tuple[int, ...]) -> None:
    assert inverse_normal(np.full(shape, 0.9)).shape == shape


def test_first_and_the_last_word_are_finite() -> None:
    """Half a step from 1, the last of them would be rounded to it."""
    ends = normal(np.array([0] * 8 + [255] * 8, np.uint8))
    assert np.isfinite(ends).all()
    assert ends[0] < -8 < 8 < ends[1]
