"""Masks from keys: reproducible everywhere, uniform, and silent."""

from __future__ import annotations

import hashlib
import traceback
from typing import Any

import numpy as np
import pytest

from veilcam_optics.camera.geometry import Camera, Panel, Window
from veilcam_optics.errors import OpticsError
from veilcam_optics.keys.masks import KeyStream, MaskDistribution, draw_levels

CAMERA = Camera()
KEY = bytes(range(32))
SMALL = Camera(window=Window(rows=2, columns=5))


def key_of(number: int) -> bytes:
    return hashlib.sha256(str(number).encode()).digest()


def test_key_stream_is_chacha20_of_rfc_8439() -> None:
    # RFC 8439, appendix A.1, test vectors 1 and 2: key 0, nonce 0, block counters 0 and 1.
    stream = KeyStream(bytes(32))
    first = stream.read(64).tobytes().hex()
    second = stream.read(64).tobytes().hex()
    assert first == (
        "76b8e0ada0f13d90405d6ae55386bd28bdd219b8a08ded1aa836efcc8b770dc7"
        "da41597c5157488d7724e03fb8d84a376a43b8f41518a11cc387b669b2ee6586"
    )
    assert second.startswith("9f07e7be5551387a98ba977c732d080dcb0f29a048e3656912c6533e32ee7aed")


# Test vectors: made once with this module; a change takes every sealed capture its scene.
VECTORS = [
    (KEY, "5bcf37951615275004ec1c776ab2f40ccbf57e793798e1bee57769f6d0342729"),
    (bytes(32), "853071e1b1bc153529f2a2d99f594a7071915a0a8ae5462f82827ccd2339bae5"),
    (bytes([255] * 32), "0f428104a072268b586dfac04c7d6388319da143b88ec9398fa47b20798fb7df"),
]


@pytest.mark.parametrize(("key", "digest"), VECTORS)
def test_levels_of_the_whole_window(key: bytes, digest: str) -> None:
    levels = draw_levels(key, camera=CAMERA)
    assert levels.shape == CAMERA.mask_shape
    assert levels.dtype == np.uint8
    assert hashlib.sha256(levels.tobytes()).hexdigest() == digest
    assert np.array_equal(draw_levels(bytearray(key), camera=CAMERA), levels)


def test_levels_of_a_small_window_are_the_stream_s_bytes() -> None:
    # 64 divides 256, so that every byte serves, and counts modulo 64.
    levels = draw_levels(KEY, camera=SMALL)
    assert levels.tolist() == [[57, 61, 43, 61, 25], [5, 25, 42, 13, 61]]
    assert np.array_equal(levels.ravel(), KeyStream(KEY).read(10) % 64)


def test_masks_of_other_keys_have_nothing_in_common() -> None:
    masks = [draw_levels(key_of(number), camera=CAMERA) for number in range(8)]
    # Not even where one bit alone differs.
    masks.append(draw_levels(key_of(0)[:-1] + bytes([key_of(0)[-1] ^ 1]), camera=CAMERA))
    for index, one in enumerate(masks):
        for other in masks[index + 1 :]:
            assert (one == other).mean() < 0.06  # 1/64 by chance


def test_key_is_left_as_it_was_and_belongs_to_its_owner() -> None:
    key = bytearray(KEY)
    levels = draw_levels(key, camera=SMALL)
    assert key == KEY
    key[:] = bytes(32)
    assert np.array_equal(draw_levels(KEY, camera=SMALL), levels)


@pytest.mark.parametrize("levels", [2, 3, 48, 64, 200, 256])
def test_levels_are_uniform_and_independent(levels: int) -> None:
    camera = Camera(panel=Panel(levels=levels))
    drawn = np.stack([draw_levels(key_of(epoch), camera=camera) for epoch in range(60)])
    counts = np.bincount(drawn.reshape(-1), minlength=levels)
    assert len(counts) == levels
    expected = drawn.size / levels
    chi_square = float(((counts - expected) ** 2 / expected).sum())
    assert chi_square < (levels - 1) + 5 * np.sqrt(2 * (levels - 1)) + 10
    centred = drawn.reshape(60, -1) - (levels - 1) / 2
    between = np.corrcoef(centred)[np.triu_indices(60, 1)]
    assert np.abs(between).max() < 6 / np.sqrt(centred.shape[1])


def test_range_bounds_each_sub_pixel_and_counts_bits() -> None:
    lowest = np.arange(10, dtype=np.uint8).reshape(2, 5)
    curve = np.arange(64, dtype=np.uint8)
    ranged = MaskDistribution(lowest, lowest + np.uint8(7), curve)
    drawn = np.stack(
        [draw_levels(key_of(e), camera=SMALL, distribution=ranged) for e in range(300)]
    )
    assert np.array_equal(drawn.min(0), ranged.lowest)
    assert np.array_equal(drawn.max(0), ranged.highest)
    assert ranged.bits == pytest.approx(30)
    assert MaskDistribution.uniform(CAMERA).bits == pytest.approx(51 * 22 * 6)
    fixed = MaskDistribution(lowest, lowest, curve)
    assert np.array_equal(draw_levels(KEY, camera=SMALL, distribution=fixed), lowest)
    assert fixed.bits == 0


def test_power_favours_dark_levels() -> None:
    power = MaskDistribution.power(CAMERA, 8.0)
    drawn = np.stack([draw_levels(key_of(e), camera=CAMERA, distribution=power) for e in range(50)])
    assert np.max(drawn) == 63
    # The curve's own numbers, each as likely as any other.
    shares = np.bincount(power.curve, minlength=64) / 64
    seen = np.bincount(drawn.reshape(-1), minlength=64) / drawn.size
    assert np.max(np.abs(seen - shares)) < 5 * np.sqrt(np.max(shares) / drawn.size)
    assert shares[0] > 0.5
    entropy = -(shares[shares > 0] * np.log2(shares[shares > 0])).sum()
    assert power.bits == pytest.approx(51 * 22 * entropy)
    with pytest.raises(OpticsError, match="exponent"):
        MaskDistribution.power(CAMERA, 0.0)


@pytest.mark.parametrize("length", [0, 16, 31, 33])
def test_refuses_a_key_of_another_length_without_repeating_it(length: int) -> None:
    key = bytes([0xC5] * length)
    with pytest.raises(OpticsError, match="a key is not valid: use 32 bytes") as refused:
        draw_levels(key, camera=CAMERA)
    text = "".join(traceback.format_exception(refused.value))
    assert key.hex() == "" or key.hex() not in text
    assert "\\xc5" not in text


ZEROS, CURVE = np.zeros((2, 5), np.uint8), np.arange(64, dtype=np.uint8)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((ZEROS + np.uint8(1), ZEROS, CURVE), "lowest exceeds"),
        ((ZEROS.astype(np.int64), ZEROS, CURVE), "lowest is not valid: use a uint8"),
        ((ZEROS, ZEROS[:1], CURVE), r"highest\.shape"),
        ((ZEROS, ZEROS, ZEROS), "1 dimensions"),
        ((ZEROS, ZEROS + np.uint8(64), CURVE), "exceeds its 64 levels"),
        ((ZEROS, ZEROS, CURVE + np.uint8(1)), "exceeds its 64 levels"),
    ],
)
def test_refuses_distributions_that_cannot_be(parts: Any, message: str) -> None:
    with pytest.raises(OpticsError, match=message):
        MaskDistribution(*parts)


def test_refuses_distributions_that_do_not_fit() -> None:
    for camera, curve, message in (
        (CAMERA, CURVE, "the window"),
        (SMALL, CURVE[:63], "the panel's, 64"),
    ):
        with pytest.raises(OpticsError, match=message):
            draw_levels(KEY, camera=camera, distribution=MaskDistribution(ZEROS, ZEROS, curve))
    with pytest.raises(OpticsError, match="at most 256"):
        MaskDistribution.uniform(Camera(panel=Panel(levels=257)))
