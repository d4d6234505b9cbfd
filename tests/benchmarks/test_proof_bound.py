"""What a smooth scene behind another mask explains, is told from what it does not."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.proof.bound import DEGREE, LIT, MOVES, copies, excess, polynomials, unexplained

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


def test_copies_of_a_scene_are_moved_and_lit() -> None:
    scene = np.random.default_rng(0).random((3, 30, 30)).astype(np.float32)
    every = copies(scene)
    lights = (LIT + 1) * (LIT + 2) // 2
    assert every.shape == (lights * (1 + 2 * len(MOVES)), 3, 30, 30)
    np.testing.assert_array_equal(every[0], scene)
    # A wave that is moved by less than its length is one of its copies' sums, however it is lit.
    y, x = np.meshgrid(*[np.linspace(-1, 1, 30)] * 2, indexing="ij")
    wave = np.repeat((1 + np.sin(9 * x))[None], 3, 0).astype(np.float32)
    other = 1 + 0.01 * y * np.sin(9 * x + 1)
    inner = (slice(None), slice(8, -8), slice(8, -8))
    explained = excess(other[inner[1:]], copies(wave)[:, 0][inner], 1e8)
    alone = excess(other[inner[1:]], polynomials(30, LIT)[:, 0][inner], 1e8)
    assert explained < 1e-2 * alone


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
    every = unexplained(
        read_bundle(FRESH),
        load_digits(),
        cameras=2,
        electrons=3e7,
        seed=1,
        kinds={"wall", "gradient", "digit"},
    )
    found = {(each.kind, each.outdoors): each.excess for each in every}
    assert {kind for kind, _ in found} == {"wall", "gradient", "digit"}
    assert found["wall", True] < 0.1
    assert found["gradient", True] < 0.1
    assert found["digit", True] > 1e3
    assert found["digit", False] > 1e3
