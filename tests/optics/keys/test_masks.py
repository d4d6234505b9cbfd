"""The key schedule: reproducible everywhere, uniform, separated by context, and silent."""

from __future__ import annotations

import hashlib
import pickle
import traceback
from pathlib import Path

import numpy as np
import pytest

from veilcam_optics.camera.geometry import Camera, Panel, Window
from veilcam_optics.errors import OpticsError
from veilcam_optics.keys.masks import KeyStream, MaskDistribution, Secret, epoch_key, epoch_levels

CAMERA = Camera()
SECRET = Secret(bytes(range(32)))
SMALL = Camera(window=Window(rows=2, columns=5))


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


# Test vectors: made once with this module; any change of the schedule must change CONTEXT too.
VECTORS = [
    ("cam-1", 0, "cd929c51ee9e37c04a70f2beba50aff403a943563626a090fa86a296a44f4b8b"),
    ("cam-1", 1, "d40f6358fb80af62743d8f39dbefb472a5d8e946c7006a1cde9aab6a458fa457"),
    ("cam-2", 1, "f2ec1ece8023f6a812cff2dde05371d99ce0509d212517e6a269b403a1dd1591"),
    (
        "kamera-\u00e4",
        2**64 - 1,
        "ca7ef370991af89b59511d353a693cfe66e6f3a3d7881bd8e073736c133605e2",
    ),
]


@pytest.mark.parametrize(("device", "epoch", "digest"), VECTORS)
def test_levels_of_the_whole_window(device: str, epoch: int, digest: str) -> None:
    levels = epoch_levels(SECRET, device, epoch, camera=CAMERA)
    assert levels.shape == CAMERA.mask_shape
    assert levels.dtype == np.uint8
    assert hashlib.sha256(levels.tobytes()).hexdigest() == digest


def test_levels_of_a_small_window_and_key() -> None:
    drawn_from = MaskDistribution.uniform(SMALL)
    key = epoch_key(SECRET, "cam-1", 7, camera=SMALL, distribution=drawn_from)
    assert key.hex() == "b3923e5b769685c3cd33dcefc5cd72cdeb31b551b326ed0559e5097511db6c86"
    assert epoch_levels(SECRET, "cam-1", 7, camera=SMALL).tolist() == [
        [6, 6, 32, 30, 62],
        [50, 28, 13, 16, 40],
    ]


def test_key_is_hkdf_by_its_definition() -> None:
    # RFC 5869: extract with a salt of zeros, then one block of expand.
    import hmac
    import struct

    drawn_from = MaskDistribution.uniform(SMALL)
    info = (
        b"veilcam mask levels, version 1\x05cam-1"
        + struct.pack(">QHHH", 7, 64, 2, 5)
        + bytes(10)
        + bytes([63] * 10)
        + bytes(range(64))
    )
    extracted = hmac.digest(bytes(32), SECRET.reveal(), "sha256")
    expanded = hmac.digest(extracted, info + b"\x01", "sha256")
    assert epoch_key(SECRET, "cam-1", 7, camera=SMALL, distribution=drawn_from) == expanded


def test_every_part_of_the_context_changes_the_mask() -> None:
    uniform = MaskDistribution.uniform(CAMERA)
    narrow = MaskDistribution(uniform.lowest, uniform.highest - np.uint8(1), uniform.curve)
    mirrored = MaskDistribution(uniform.lowest, uniform.highest, uniform.curve[::-1].copy())
    masks = [
        epoch_levels(SECRET, "a", 1, camera=CAMERA),
        epoch_levels(Secret(bytes(32)), "a", 1, camera=CAMERA),
        epoch_levels(SECRET, "b", 1, camera=CAMERA),
        epoch_levels(SECRET, "a", 2, camera=CAMERA),
        epoch_levels(SECRET, "a", 1, camera=Camera(panel=Panel(levels=63))),
        epoch_levels(SECRET, "a", 1, camera=CAMERA, distribution=narrow),
        epoch_levels(SECRET, "a", 1, camera=CAMERA, distribution=mirrored),
        63 - epoch_levels(SECRET, "a", 1, camera=CAMERA, distribution=mirrored),
    ]
    for index, one in enumerate(masks):
        for other in masks[index + 1 :]:
            assert (one == other).mean() < 0.06  # 1/64 by chance


@pytest.mark.parametrize("levels", [2, 3, 48, 64, 200, 256])
def test_levels_are_uniform_and_independent(levels: int) -> None:
    camera = Camera(panel=Panel(levels=levels))
    drawn = np.stack([epoch_levels(SECRET, "a", epoch, camera=camera) for epoch in range(60)])
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
        [epoch_levels(SECRET, "a", e, camera=SMALL, distribution=ranged) for e in range(300)]
    )
    assert np.array_equal(drawn.min(0), ranged.lowest)
    assert np.array_equal(drawn.max(0), ranged.highest)
    assert ranged.bits == pytest.approx(30)
    assert MaskDistribution.uniform(CAMERA).bits == pytest.approx(51 * 22 * 6)
    fixed = MaskDistribution(lowest, lowest, curve)
    assert np.array_equal(epoch_levels(SECRET, "a", 0, camera=SMALL, distribution=fixed), lowest)
    assert fixed.bits == 0


def test_power_favours_dark_levels() -> None:
    power = MaskDistribution.power(CAMERA, 8.0)
    drawn = np.stack(
        [epoch_levels(SECRET, "a", e, camera=CAMERA, distribution=power) for e in range(50)]
    )
    assert drawn.max() == 63
    # The curve's own numbers, each as likely as any other.
    shares = np.bincount(power.curve, minlength=64) / 64
    seen = np.bincount(drawn.reshape(-1), minlength=64) / drawn.size
    assert np.abs(seen - shares).max() < 5 * np.sqrt(shares.max() / drawn.size)
    assert shares[0] > 0.5
    entropy = -(shares[shares > 0] * np.log2(shares[shares > 0])).sum()
    assert power.bits == pytest.approx(51 * 22 * entropy)
    with pytest.raises(OpticsError, match="exponent"):
        MaskDistribution.power(CAMERA, 0.0)


def test_secret_never_shows(tmp_path: Path) -> None:
    secret = Secret.generate()
    digits = secret.reveal().hex()
    shown = [
        repr(secret),
        str(secret),
        f"{secret}",
        f"{secret!r}",
        repr([secret]),
        repr({1: secret}),
    ]
    assert all(digits not in text and "Secret(...)" in text for text in shown)
    with pytest.raises(TypeError, match="not pickled") as failure:
        pickle.dumps(secret)
    assert digits not in str(failure.value)
    with pytest.raises(TypeError, match="unhashable"):
        hash(secret)
    assert not hasattr(secret, "__dict__")

    path = tmp_path / "secret"
    path.write_text(digits + "0")
    path.chmod(0o600)
    for bad in (
        lambda: Secret.from_hex(digits[:-1] + "x"),
        lambda: Secret(secret.reveal() + b"1"),
        lambda: Secret.read(path),
        lambda: epoch_levels(secret, "", 0, camera=CAMERA),
        lambda: epoch_levels(secret, "a", -1, camera=CAMERA),
    ):
        with pytest.raises(OpticsError) as refused:
            bad()
        text = "".join(traceback.format_exception(refused.value))
        assert digits[:16] not in text
        assert "\\x" not in text


def test_secret_file(tmp_path: Path) -> None:
    secret, path = Secret.generate(), tmp_path / "secret"
    path.write_text(secret.reveal().hex().upper() + "\n")
    path.chmod(0o644)
    with pytest.raises(OpticsError, match="open to others: run chmod 600"):
        Secret.read(path)
    path.chmod(0o600)
    assert Secret.read(path) == secret
    assert Secret.read(path) != Secret.generate()
    with pytest.raises(OpticsError, match="cannot be read"):
        Secret.read(tmp_path / "missing")


@pytest.mark.parametrize(
    ("device", "epoch", "message"),
    [
        ("", 0, "device"),
        ("x" * 256, 0, "device"),
        ("a", -1, "epoch"),
        ("a", 2**64, "epoch"),
        ("a", True, "epoch"),
    ],
)
def test_refuses_what_is_no_context(device: str, epoch: int, message: str) -> None:
    with pytest.raises(OpticsError, match=message):
        epoch_levels(SECRET, device, epoch, camera=CAMERA)


def test_refuses_distributions_that_do_not_fit() -> None:
    zeros, curve = np.zeros((2, 5), np.uint8), np.arange(64, dtype=np.uint8)
    one = np.uint8(1)
    with pytest.raises(OpticsError, match="lowest exceeds"):
        MaskDistribution(zeros + one, zeros, curve)
    with pytest.raises(OpticsError, match="lowest is not valid: use a uint8"):
        MaskDistribution(zeros.astype(np.int64), zeros, curve)
    with pytest.raises(OpticsError, match=r"highest\.shape"):
        MaskDistribution(zeros, zeros[:1], curve)
    with pytest.raises(OpticsError, match="1 dimensions"):
        MaskDistribution(zeros, zeros, zeros)
    with pytest.raises(OpticsError, match="exceeds its 64 levels"):
        MaskDistribution(zeros, zeros + np.uint8(64), curve)
    with pytest.raises(OpticsError, match="exceeds its 64 levels"):
        MaskDistribution(zeros, zeros, curve + one)
    small = MaskDistribution(zeros, zeros, curve)
    with pytest.raises(OpticsError, match="the window"):
        epoch_levels(SECRET, "a", 0, camera=CAMERA, distribution=small)
    short = MaskDistribution(zeros, zeros, curve[:63])
    with pytest.raises(OpticsError, match="the panel's, 64"):
        epoch_levels(SECRET, "a", 0, camera=SMALL, distribution=short)
    with pytest.raises(OpticsError, match="at most 256"):
        MaskDistribution.uniform(Camera(panel=Panel(levels=257)))
