"""A device's key, and a receiver."""

from __future__ import annotations

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from veilcam_client.keys.receivers import ReceiverKey


class Device:
    """Signs as a camera does."""

    def __init__(self) -> None:
        self._key = Ed25519PrivateKey.generate()
        self.public = self._key.public_key().public_bytes_raw().hex()

    def sign(self, message: bytes) -> str:
        return self._key.sign(message).hex()


@pytest.fixture
def device() -> Device:
    return Device()


@pytest.fixture
def make_device() -> type[Device]:
    return Device


@pytest.fixture(scope="session")
def receiver() -> ReceiverKey:
    return ReceiverKey.generate()
