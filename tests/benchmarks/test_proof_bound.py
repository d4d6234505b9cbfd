"""What a smooth scene behind another mask explains, is told from what it does not."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.proof.bound import DEGREE, excess, polynomials, unexplained

from veilcam_server.demo_data import FRESH, load_digits
from veilcam_training.bundle import read_bundle


def test_polynomials_are_all_of_their_degree() -> None:
    scenes = polynomials(21)[:, 0]
    assert len(scenes) == (DEGREE + 1) * (DEGREE + 2) // 2
    y, x = np.meshgrid(*[np.linspace(-1, 1, 21)] * 2, indexing="ij")
    # Noise is that of a light of 1, so that what is left over is a sum of squares.
    light = np.ones_like(x)
    assert excess(light + 1e-3 * y**3 * x**5, scenes, 1e12) < 1e-2
    assert excess(light + 1e-3 * y**9, scenes, 1e12) > 1


def test_what_is_left_over_is_counted_in_noise() -> None:
    chance = np.random.default_rng(0)
    light = np.ones((48, 64))
    even = np.ones((1, 48, 64), np.float32)
    noisy = light + 1e-3 * chance.standard_normal(light.shape)
    assert excess(noisy, even, 1e6) == pytest.approx(1, rel=0.1)
    assert excess(noisy, even, 1e8) == pytest.approx(100, rel=0.1)


@pytest.mark.slow
def test_nobody_can_tell_a_wall_and_anybody_a_digit() -> None:
    # The second camera of this seed sees all of the half space.
    found = {
        (each.kind, each.outdoors): each.excess
        for each in unexplained(read_bundle(FRESH), load_digits(), cameras=2, electrons=3e7, seed=1)
    }
    assert found["wall", True] < 0.1
    assert found["gradient", True] < 0.1
    assert found["digit", True] > 1e3
    assert found["digit", False] > 1e3
