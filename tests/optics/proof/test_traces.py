"""Traces hold what a mask leaves, and neither scene, nor noise, nor flicker."""

from __future__ import annotations

import numpy as np
import pytest
from tests.optics.proof.rig import Single

from veilcam_optics.camera.geometry import Embedding
from veilcam_optics.proof.traces import Traces

BINS = Embedding(24, 32)
TRACES = Traces(BINS)
NONE = np.zeros((1, *BINS.shape), bool)
FREQUENCIES = 48 * 33


def _texture(seed: int = 1) -> Single:
    """Texture as apertures pass it: nothing at the highest frequencies."""
    chance = np.random.default_rng(seed)
    spectrum = np.fft.rfft2(chance.standard_normal(BINS.shape))
    spectrum[:, 12:] = 0
    texture: Single = (10 + np.fft.irfft2(spectrum, BINS.shape))[None].astype(np.float32)
    return texture


def test_a_trace_is_of_every_capture() -> None:
    captures = np.concatenate([_texture(1), _texture(2)])
    trace = TRACES.take(captures, np.zeros(captures.shape, bool))
    assert trace.power.shape == (2, FREQUENCIES)
    assert trace.power.dtype == np.float32
    alone = TRACES.take(captures[1:], NONE)
    np.testing.assert_allclose(trace.power[1], alone.power[0], rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(trace.mean, captures.mean((1, 2)), rtol=1e-6)


def test_brightness_does_not_count() -> None:
    dim, bright = (TRACES.take(scale * _texture(), NONE) for scale in (1.0, 1e3))
    np.testing.assert_allclose(dim.power, bright.power, rtol=1e-2, atol=1e-2)
    assert dim.unevenness == pytest.approx(bright.unevenness, rel=1e-4)


def test_the_power_of_a_scene_does_not_count() -> None:
    plain = _texture()
    # A scene whose power falls smoothly by a factor of 30.
    y, x = np.pi * np.arange(24)[:, None] / 24, np.pi * np.arange(32) / 32
    cosines_y, cosines_x = (
        np.cos(np.arange(side)[:, None] * np.pi / side * (np.arange(side) + 0.5))
        for side in BINS.shape
    )
    falling = 1 / (1 + 0.5 * (y**2 + x**2))
    coefficients = np.linalg.solve(cosines_y.T, plain[0] - 10) @ np.linalg.inv(cosines_x)
    steep = 10 + cosines_y.T @ (coefficients * falling) @ cosines_x
    traces = [
        TRACES.take(each.reshape(1, 24, 32).astype(np.float32), NONE).power[0]
        for each in (plain, steep)
    ]
    assert np.corrcoef(*traces)[0, 1] > 0.98


def test_pure_noise_leaves_next_to_nothing() -> None:
    noise = np.random.default_rng(1).standard_normal((20, *BINS.shape)).astype(np.float32)
    mine = TRACES.take(10 + noise, np.zeros(noise.shape, bool)).power.sum(1)
    assert mine.mean() < 0.15 * TRACES.take(_texture(), NONE).power.sum()


def test_rows_that_flicker_leave_nothing() -> None:
    rows = np.ones((1, 24, 32), np.float32)
    rows *= 1 + 0.2 * np.sin(np.arange(24) / 24 * 15)[:, None].astype(np.float32)
    rows *= np.linspace(1, 2, 32, dtype=np.float32) ** 0.1
    still = TRACES.take(_texture(), NONE).power.sum()
    assert TRACES.take(_texture() * rows, NONE).power.sum() == pytest.approx(still, rel=0.2)
    even = 0 * _texture() + 1
    assert TRACES.take(even * rows[:, :, :1], NONE).unevenness[0] < 1e-5


def test_unevenness_is_the_rms_of_the_profile_over_its_mean() -> None:
    x = (np.arange(32) + 0.5) / 32
    capture = np.ones((1, 24, 1)) * (2 + 0.3 * np.cos(2 * np.pi * x) + 0.5 * np.cos(20 * np.pi * x))
    found = TRACES.take(capture.astype(np.float32), NONE).unevenness[0]
    # The tenth cosine and those above are texture.
    assert found == pytest.approx(0.3 / 2**0.5 / 2, rel=1e-4)


def test_clipped_bins_are_taken_from_their_neighbours() -> None:
    y, x = np.indices(BINS.shape)
    smooth = (5 + np.sin(y / 9) + np.cos(x / 9))[None].astype(np.float32)
    clipped = NONE.copy()
    clipped[0, 5, 7] = clipped[0, 12:14, 20:22] = True
    broken = np.where(clipped, 1e6, smooth).astype(np.float32)
    mine, whole = TRACES.take(broken, clipped), TRACES.take(smooth, NONE)
    assert mine.mean[0] == pytest.approx(whole.mean[0], rel=1e-4)
    assert mine.unevenness[0] == pytest.approx(whole.unevenness[0], rel=1e-2)


def test_no_light_and_no_bin_are_no_errors() -> None:
    for capture in (np.zeros((1, *BINS.shape), np.float32), -_texture()):
        for clipped in (NONE, ~NONE):
            trace = TRACES.take(capture, clipped)
            assert np.isfinite(trace.power).all()
            assert np.isfinite(trace.unevenness).all()
