"""A device that seals, and what it answers."""

from __future__ import annotations

import secrets
from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from veilcam_client.keys.blocks import Sealer
from veilcam_client.keys.envelopes import seal_key
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.captures import Capture, Exposure, Notes, Timing

BUNDLE = "0f" * 32
AT = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
VALUES: npt.NDArray[np.float32] = np.arange(6, dtype=np.float32).reshape(2, 3)
NOTES = Notes(
    exposure=Exposure(started_after_shown_s=0.104, settle_s=0.1, duration_s=0.01),
    timing=Timing(queue_s=0.0, rotation_s=0.02, settle_s=0.08, capture_s=0.05),
    scene=3,
)


class Device:
    def __init__(self) -> None:
        self._key = Ed25519PrivateKey.generate()
        self.public = self._key.public_key().public_bytes_raw().hex()

    def sign(self, message: bytes) -> str:
        return self._key.sign(message).hex()


class Epoch:
    def __init__(self, device: Device, receiver: ReceiverKey) -> None:
        self.name = secrets.token_hex(16)
        self.key = EpochKey.generate(device=device.public, bundle=BUNDLE)
        to = [receiver.public]
        envelope = seal_key(self.key, device, epoch=self.name, bundle=BUNDLE, receivers=to)
        self.sealer = Sealer(self.key, envelope)

    def capture(
        self,
        number: int,
        at: datetime = AT,
        values: npt.NDArray[np.float32] = VALUES,
        notes: Notes = NOTES,
    ) -> Capture:
        sealed = self.sealer.seal(number, at, values, notes)
        told = Capture(
            id="1", epoch=self.name, number=number, taken_at=at, embedding=sealed
        ).model_dump_json()
        return Capture.model_validate_json(told)
