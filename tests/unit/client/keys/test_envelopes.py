"""Envelopes: who opens them, and what is refused."""

from __future__ import annotations

import base64
import hashlib
import json

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from pydantic import ValidationError
from tests.unit.client.sealing import BUNDLE, Device

from veilcam_client.errors import SealedError
from veilcam_client.keys.envelopes import canonical, open_key, receivers_digest, seal_key
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.sealing import Envelope

EPOCH = "ab" * 16


@pytest.fixture
def key(device: Device) -> EpochKey:
    return EpochKey.generate(device=device.public, bundle=BUNDLE)


def sealed(key: EpochKey, device: Device, *receivers: ReceiverKey) -> Envelope:
    to = [each.public for each in receivers]
    return seal_key(key, device, epoch=EPOCH, bundle=BUNDLE, receivers=to)


def test_every_receiver_opens_it_and_nobody_else(
    key: EpochKey, device: Device, receiver: ReceiverKey
) -> None:
    other = ReceiverKey.generate()
    envelope = sealed(key, device, receiver, other)
    again = Envelope.model_validate_json(envelope.model_dump_json())
    for pinned in (None, device.public):
        assert open_key(again, receiver, device=pinned) == key
        assert open_key(again, other, device=pinned) == key
    with pytest.raises(SealedError, match="not sealed to receiver"):
        open_key(envelope, ReceiverKey.generate(), device=None)
    with pytest.raises(SealedError, match="check the camera"):
        open_key(envelope, receiver, device="ab" * 32)


def test_signed_text_is_canonical() -> None:
    assert canonical("a", 1, ["b"]) == b'["a",1,["b"]]'
    ids = ["b" * 64, "a" * 64]
    told = hashlib.sha256(f"{ids[1]}\n{ids[0]}".encode()).hexdigest()
    assert receivers_digest(ids) == receivers_digest(reversed(ids)) == told


def test_envelope_is_what_its_format_says(
    key: EpochKey, device: Device, receiver: ReceiverKey
) -> None:
    """Checked and opened here by the standards alone, as another implementation would."""
    envelope = sealed(key, device, receiver)
    (held,) = envelope.keys
    message = (
        f'["veilcam envelope",1,"{device.public}","{EPOCH}","{BUNDLE}",'
        f'[["{receiver.public.id}","{held.key}"]]]'
    )
    Ed25519PublicKey.from_public_bytes(bytes.fromhex(device.public)).verify(
        bytes.fromhex(envelope.signature), message.encode()
    )
    digest = hashlib.sha256(receiver.public.id.encode()).hexdigest()
    info = f'["veilcam epoch key",1,"{device.public}","{EPOCH}","{digest}"]'
    assert receiver.open(base64.b64decode(held.key), info.encode()) == key.reveal()
    assert held.receiver == hashlib.sha256(receiver.public.raw).hexdigest()


def test_changed_envelope_is_refused(key: EpochKey, device: Device, receiver: ReceiverKey) -> None:
    envelope = sealed(key, device, receiver, ReceiverKey.generate())
    other = sealed(key, device, receiver)
    for change in (
        {"epoch": "cd" * 16},
        {"bundle": "1e" * 32},
        {"device": "ab" * 32},
        {"keys": other.keys},
        {"keys": envelope.keys[::-1]},
        {"signature": other.signature},
    ):
        changed = envelope.model_copy(update=change)
        with pytest.raises(SealedError, match="changed after the device signed it"):
            open_key(changed, receiver, device=None)


def test_wrongly_sealed_key_does_not_open(
    key: EpochKey, device: Device, receiver: ReceiverKey
) -> None:
    """Signed, but sealed under another context: to other receivers, or of another epoch."""
    first = sealed(key, device, receiver)
    for epoch, keys in (
        ("cd" * 16, first.keys),
        (EPOCH, (first.keys[0], sealed(key, device, ReceiverKey.generate()).keys[0])),
        (EPOCH, (first.keys[0].model_copy(update={"key": "c2VhbGVk"}),)),
    ):
        told = [[each.receiver, each.key] for each in keys]
        message = canonical("veilcam envelope", 1, device.public, epoch, BUNDLE, told)
        forged = first.model_copy(
            update={"epoch": epoch, "keys": keys, "signature": device.sign(message)}
        )
        with pytest.raises(SealedError, match="made wrongly"):
            open_key(forged, receiver, device=None)


def test_envelope_has_one_to_eight_receivers_each_once(
    key: EpochKey, device: Device, receiver: ReceiverKey
) -> None:
    with pytest.raises(ValueError, match="0 receivers are not valid: use 1 to 8"):
        sealed(key, device)
    with pytest.raises(ValueError, match="9 receivers are not valid"):
        sealed(key, device, *[receiver] * 9)
    with pytest.raises(ValidationError, match="a receiver stands in an envelope once"):
        sealed(key, device, receiver, receiver)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("device", "D7" * 32),
        ("device", "d7 " * 32),
        ("epoch", "ab" * 15),
        ("bundle", "0f" * 32 + "\n"),
        ("signature", "0F" * 64),  # the same bytes: an envelope has one text
        ("version", 2),
        ("keys", []),
        ("keys", [{"receiver": "0F" * 32, "key": "c2VhbGVk"}]),
        ("keys", [{"receiver": "0f" * 32, "key": "c2Vhb GVk"}]),
    ],
)
def test_envelope_has_one_text(
    key: EpochKey, device: Device, receiver: ReceiverKey, name: str, text: object
) -> None:
    told = json.loads(sealed(key, device, receiver).model_dump_json())
    with pytest.raises(ValidationError):
        Envelope.model_validate_json(json.dumps({**told, name: text}))


def test_erased_key_is_not_sealed(key: EpochKey, device: Device, receiver: ReceiverKey) -> None:
    key.erase()
    with pytest.raises(ValueError, match="was erased"):
        sealed(key, device, receiver)
