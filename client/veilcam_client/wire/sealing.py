"""Sealing of embeddings: forms, envelopes and receivers."""

from __future__ import annotations

from datetime import datetime
from typing import Literal

from pydantic import Field, field_validator

from veilcam_client.wire.base import EXAMPLE_DIGEST, EXAMPLE_EPOCH, EXAMPLE_TIME, Answer, Question

Form = Literal["sealed", "raw"]
"""How an embedding leaves: ``sealed`` to the camera's receivers, or ``raw``, as it was read."""

Release = Literal["none", "sealed", "raw"]
"""The form in which a daemon lets embeddings out; ``none``: not at all."""

ENVELOPE_VERSION: Literal[1] = 1
MOST_RECEIVERS = 8
"""That a camera may have."""
_NAME, _DIGEST, _SIGNATURE = (rf"^[0-9a-f]{{{digits}}}$" for digits in (32, 64, 128))
_BASE64 = r"^[A-Za-z0-9+/]+={0,2}$"


class SealedKey(Answer):
    """The key of an epoch, for one receiver."""

    receiver: str = Field(pattern=_DIGEST)
    """SHA-256 of its public key."""
    key: str = Field(repr=False, pattern=_BASE64)
    """HPKE ciphertext, base64."""


class Envelope(Answer):
    """The key of an epoch, sealed to every receiver and signed by the device."""

    version: Literal[1] = ENVELOPE_VERSION
    """Version of the envelope's format."""
    device: str = Field(pattern=_DIGEST)
    """Public Ed25519 key of the device, 64 hexadecimal digits."""
    epoch: str = Field(pattern=_NAME)
    """Random name of one showing of one mask."""
    bundle: str = Field(pattern=_DIGEST)
    """SHA-256 of the bundle in use."""
    keys: tuple[SealedKey, ...] = Field(min_length=1, max_length=MOST_RECEIVERS)
    """The key of the epoch, for each receiver."""
    signature: str = Field(repr=False, pattern=_SIGNATURE)
    """Ed25519 signature of all the rest, 128 hexadecimal digits."""

    @field_validator("keys")
    @classmethod
    def _once_each(cls, keys: tuple[SealedKey, ...]) -> tuple[SealedKey, ...]:
        if len({each.receiver for each in keys}) != len(keys):
            raise ValueError("a receiver stands in an envelope once")
        return keys


class ReceiverRequest(Question):
    """A receiver to be paired with."""

    label: str = Field(min_length=1, max_length=64, pattern=r"^[\x20-\x7e]+$")
    """For whom or what it is; it stands in the status and in the log."""
    key: str = Field(repr=False, max_length=2048, pattern=r"^veilcam-receiver:[A-Za-z0-9+/=]+$")
    """Its public key, as ``veilcam receiver keygen`` prints it."""


class PairedReceiver(Answer):
    """A receiver that epochs are sealed to."""

    id: str
    """SHA-256 of its public key: its name in envelopes."""
    label: str
    """Label for people."""
    added_at: datetime
    """Time of the pairing."""


class Receivers(Answer):
    """All receivers, the oldest first, and the device that seals to them."""

    device: str
    """Its public Ed25519 key, 64 hexadecimal digits: give it to receivers, who check it."""
    receivers: tuple[PairedReceiver, ...]
    """Receivers, the oldest first."""


EXAMPLE_DEVICE = "d7" * 32


def example_receiver() -> PairedReceiver:
    """Return a PairedReceiver for documents."""
    return PairedReceiver(id=EXAMPLE_DIGEST, label="archive", added_at=EXAMPLE_TIME)


def example_envelope() -> Envelope:
    """Return an Envelope for documents."""
    return Envelope(
        device=EXAMPLE_DEVICE,
        epoch=EXAMPLE_EPOCH,
        bundle=EXAMPLE_DIGEST,
        keys=(SealedKey(receiver=EXAMPLE_DIGEST, key="c2VhbGVk"),),
        signature="0f" * 64,
    )


def examples() -> tuple[Answer | Question, ...]:
    """Return examples for documents."""
    return (
        ReceiverRequest(label="archive", key="veilcam-receiver:c2VhbGVk"),
        example_receiver(),
        Receivers(device=EXAMPLE_DEVICE, receivers=(example_receiver(),)),
        example_envelope(),
    )
