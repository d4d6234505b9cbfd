"""Envelopes: the key of an epoch, sealed to every receiver and signed by the device."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterable, Sequence
from typing import Protocol

from cryptography.exceptions import InvalidSignature, InvalidTag
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from veilcam_client.errors import SealedError
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import Receiver, ReceiverKey
from veilcam_client.wire.sealing import ENVELOPE_VERSION, MOST_RECEIVERS, Envelope, SealedKey


class Signer(Protocol):
    """A device's Ed25519 key."""

    @property
    def public(self) -> str:
        """The public half, 64 hexadecimal digits."""

    def sign(self, message: bytes) -> str:
        """Signature of ``message`` (RFC 8032), 128 hexadecimal digits."""


def is_signed(public: str, signature: str, message: bytes) -> bool:
    """Return whether the owner of an Ed25519 key signed a message; key and signature in hex."""
    try:
        key = Ed25519PublicKey.from_public_bytes(bytes.fromhex(public))
        key.verify(bytes.fromhex(signature), message)
    except (ValueError, InvalidSignature):
        return False
    return True


def canonical(*fields: object) -> bytes:
    """One text for these fields, and no other fields have it: what is signed or sealed with."""
    return json.dumps(fields, separators=(",", ":"), ensure_ascii=True).encode()


def receivers_digest(ids: Iterable[str]) -> str:
    """SHA-256 of who receives, in the order of their names: 64 hexadecimal digits."""
    return hashlib.sha256("\n".join(sorted(ids)).encode()).hexdigest()


def seal_key(
    key: EpochKey, signer: Signer, *, epoch: str, bundle: str, receivers: Sequence[Receiver]
) -> Envelope:
    """Seal an epoch's key to its receivers.

    Args:
        key: key of the epoch.
        signer: the device.
        epoch: name of the epoch.
        bundle: SHA-256 of the bundle in use, as the key has it.
        receivers: 1 to 8, none of them twice.

    Raises:
        ValueError: the receivers or a name are not valid, or the key was erased.
    """
    if not 1 <= len(receivers) <= MOST_RECEIVERS:
        raise ValueError(f"{len(receivers)} receivers are not valid: use 1 to {MOST_RECEIVERS}")
    info = _info(signer.public, epoch, receivers_digest(each.id for each in receivers))
    keys = tuple(
        SealedKey(receiver=each.id, key=base64.b64encode(each.seal(key.reveal(), info)).decode())
        for each in receivers
    )
    return Envelope(
        device=signer.public,
        epoch=epoch,
        bundle=bundle,
        keys=keys,
        signature=signer.sign(_message(signer.public, epoch, bundle, keys)),
    )


def open_key(envelope: Envelope, key: ReceiverKey, *, device: str | None) -> EpochKey:
    """Return the key of an epoch, once it is sure whose it is.

    Args:
        envelope: envelope as it came.
        key: key of a receiver.
        device: public key that has to have signed it, 64 hexadecimal digits; None: any.

    Raises:
        SealedError: another device signed it, or it was changed, or it is not for this receiver.
    """
    if device is not None and envelope.device != device:
        raise SealedError(
            f"this was sealed by device {envelope.device[:12]}, not {device[:12]}: check the camera"
        )
    message = _message(envelope.device, envelope.epoch, envelope.bundle, envelope.keys)
    if not is_signed(envelope.device, envelope.signature, message):
        raise SealedError("the envelope was changed after the device signed it")
    sealed = {each.receiver: each.key for each in envelope.keys}.get(key.public.id)
    if sealed is None:
        raise SealedError(
            f"this is not sealed to receiver {key.public.id[:12]}: add it with "
            "'veilcam receiver add', or use another key"
        )
    digest = receivers_digest(each.receiver for each in envelope.keys)
    try:
        value = key.open(
            base64.b64decode(sealed, validate=True),
            _info(envelope.device, envelope.epoch, digest),
        )
        return EpochKey(value, device=envelope.device, bundle=envelope.bundle)
    except (ValueError, InvalidTag):
        raise SealedError("the envelope cannot be opened: it was made wrongly") from None


def _info(device: str, epoch: str, receivers: str) -> bytes:
    return canonical("veilcam epoch key", ENVELOPE_VERSION, device, epoch, receivers)


def _message(device: str, epoch: str, bundle: str, keys: Sequence[SealedKey]) -> bytes:
    sealed = [[each.receiver, each.key] for each in keys]
    return canonical("veilcam envelope", ENVELOPE_VERSION, device, epoch, bundle, sealed)
