"""Keys of epochs: what is derived, what never shows, and what is gone."""

from __future__ import annotations

import copy
import hashlib
import hmac
import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from veilcam_client.keys.epoch_key import EpochKey

VALUE, DEVICE, BUNDLE = bytes(range(32)), "d7" * 32, "0f" * 32
USES = {
    "levels": b"veilcam mask levels 1",
    "sealing": b"veilcam embedding sealing 1",
    "commitment": b"veilcam mask commitment 1",
}
keys = st.binary(min_size=32, max_size=32)


@given(value=keys, device=keys, bundle=keys, use=st.sampled_from(sorted(USES)))
def test_keys_are_derived_by_hkdf_expand(
    value: bytes, device: bytes, bundle: bytes, use: str
) -> None:
    """RFC 5869, 2.3: T(1) = HMAC(PRK, info | 0x01) is all that 32 bytes need."""
    key = EpochKey(value, device=device.hex(), bundle=bundle.hex())
    info = USES[use] + b"\0" + device + bundle
    assert getattr(key, use)() == hmac.digest(value, info + b"\x01", hashlib.sha256)


def test_keys_are_drawn_anew() -> None:
    drawn = [EpochKey.generate(device=DEVICE, bundle=BUNDLE) for _ in range(100)]
    assert len({bytes(key.reveal()) for key in drawn}) == 100
    assert all(len(key.reveal()) == 32 for key in drawn)


def test_erased_key_derives_nothing() -> None:
    key = EpochKey(VALUE, device=DEVICE, bundle=BUNDLE)
    held = key.reveal()
    assert held == VALUE
    key.erase()
    key.erase()
    assert held == bytes(32)  # the memory itself, and no copy
    for use in (*USES, "reveal"):
        with pytest.raises(ValueError, match="was erased"):
            getattr(key, use)()


def test_given_key_is_copied() -> None:
    given_value = bytearray(VALUE)
    key = EpochKey(given_value, device=DEVICE, bundle=BUNDLE)
    given_value[:] = bytes(32)
    assert key.reveal() == VALUE


@pytest.mark.parametrize(
    ("value", "device", "bundle"),
    [
        (VALUE[:-1], DEVICE, BUNDLE),
        (VALUE + b"1", DEVICE, BUNDLE),
        (VALUE, "camera", BUNDLE),
        (VALUE, DEVICE[2:], BUNDLE),
        (VALUE, DEVICE[2:], "0f" + BUNDLE),  # 64 bytes together, and still no two names
    ],
)
def test_invalid_key_is_refused_and_not_repeated(value: bytes, device: str, bundle: str) -> None:
    with pytest.raises(ValueError) as refused:  # noqa: PT011 - whatever it says, it tells no key
        EpochKey(value, device=device, bundle=bundle)
    assert repr(value)[2:8] not in str(refused.value)
    assert value.hex() not in str(refused.value)


def test_epoch_key_shows_nowhere() -> None:
    key = EpochKey(VALUE, device=DEVICE, bundle=BUNDLE)
    assert repr(key) == str(key) == f"{key}" == "EpochKey(...)"
    for leak in (pickle.dumps, copy.copy, copy.deepcopy):
        with pytest.raises(TypeError, match="not pickled"):
            leak(key)
    with pytest.raises(TypeError):
        hash(key)


def test_keys_are_equal_when_they_derive_the_same() -> None:
    key = EpochKey(VALUE, device=DEVICE, bundle=BUNDLE)
    assert key == EpochKey(VALUE, device=DEVICE, bundle=BUNDLE)
    assert key != EpochKey(VALUE, device=BUNDLE, bundle=BUNDLE)
    assert key != EpochKey(bytes(32), device=DEVICE, bundle=BUNDLE)
    assert key != VALUE
