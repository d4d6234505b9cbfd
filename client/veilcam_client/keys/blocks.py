"""Sealed embeddings: blocks of one size, whatever the camera saw.

ChaCha20-Poly1305 (RFC 8439) under a key of the epoch. The nonce is the number of the capture in its
epoch; the associated data are all that an answer says in the clear, and the form, so that nothing
can be moved from one answer to another.
"""

from __future__ import annotations

import base64
import json
import threading
from collections import OrderedDict
from dataclasses import dataclass
from datetime import datetime
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
from pydantic import ValidationError

from veilcam_client.errors import SealedError
from veilcam_client.keys.envelopes import open_key, receivers_digest
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.captures import (
    Capture,
    Classification,
    Embedding,
    Notes,
    SealedEmbedding,
)
from veilcam_client.wire.sealing import Envelope

BLOCK_VERSION = 1
NOTES_BYTES = 512
"""Of a block, after the values: the notes, filled up with spaces."""
MOST_EPOCHS = 65_536
"""So many epochs an opener remembers, to refuse what comes twice."""

AnswerT = TypeVar("AnswerT", Capture, Classification)


class Sealer:
    """Seals the embeddings of one epoch, each number once.

    Args:
        key: of the epoch.
        envelope: that goes with every embedding.
    """

    def __init__(self, key: EpochKey, envelope: Envelope) -> None:
        self._key, self._envelope, self._last = key.sealing(), envelope, -1

    def seal(
        self, number: int, taken_at: datetime, values: npt.NDArray[np.float32], notes: Notes
    ) -> SealedEmbedding:
        """Seal one embedding.

        Args:
            number: of the capture in its epoch, above all that were sealed before.
            taken_at: to the second, UTC.
            values: float32, any shape.
            notes: that go with it.

        Raises:
            ValueError: the number was used, the values are no float32, or the notes are too long.
        """
        if number <= self._last:
            raise ValueError(f"capture {number} of this epoch was sealed already")
        if values.dtype != np.float32:
            raise ValueError(f"values of {values.dtype} are not sealed: use float32")
        said = notes.model_dump_json().encode()
        if len(said) > NOTES_BYTES:
            raise ValueError(f"notes of {len(said)} bytes are too long: use {NOTES_BYTES}")
        self._last = number
        block = values.astype("<f4").tobytes() + said.ljust(NOTES_BYTES)
        data = _associated_data(self._envelope, values.shape, number, taken_at)
        sealed = ChaCha20Poly1305(self._key).encrypt(_nonce(number), block, data)
        return SealedEmbedding(
            shape=values.shape,
            block=base64.b64encode(sealed).decode(),
            envelope=self._envelope,
        )

    def erase(self) -> None:
        """Overwrite the key: nothing is sealed any more. Twice does no harm."""
        self._key[:] = bytes(len(self._key))
        # A zero key would seal, and everybody would open it.
        self._last = 2**96


@dataclass(slots=True)
class _Opened:
    """An epoch whose envelope was opened."""

    key: bytearray
    envelope: Envelope
    last: int
    """Number that was opened last."""
    latest: datetime
    """When that was taken."""


class Opener:
    """Opens what one camera seals to one receiver, each number once and in their order.

    It remembers ``MOST_EPOCHS`` epochs; of one that it has forgotten, or never saw, nothing is
    taken that is older than what it forgot.

    Args:
        key: of the receiver.
        device: public key of the camera, 64 hexadecimal digits; None: that of the first envelope
            that comes, from then on.
    """

    def __init__(self, key: ReceiverKey, device: str | None = None) -> None:
        self._key, self._device = key, device
        self._epochs: OrderedDict[str, _Opened] = OrderedDict()
        self._forgotten: datetime | None = None
        self._lock = threading.Lock()

    def open(self, answer: AnswerT) -> AnswerT:
        """Return the answer with its embedding as it was read, and with its notes.

        Raises:
            SealedError: it is not for this receiver or of another camera, it was changed, or it
                came before.
        """
        sealed = answer.embedding
        if not isinstance(sealed, SealedEmbedding):
            return answer
        with self._lock:
            epoch = self._epoch(answer, sealed)
            values, notes = self._opened(epoch, answer, sealed)
            if answer.number <= epoch.last or self._too_old(answer):
                raise SealedError(
                    f"capture {answer.number} of epoch {answer.epoch} came before, or later than "
                    "one that was taken after it"
                )
            self._remember(answer, epoch)
        embedding = Embedding.from_array(values, form="raw")
        return answer.model_copy(update={"embedding": embedding, "notes": notes})

    def _epoch(self, answer: Capture | Classification, sealed: SealedEmbedding) -> _Opened:
        """The epoch of an answer: known, or from its envelope."""
        known = self._epochs.get(answer.epoch)
        if known is not None and known.envelope == sealed.envelope:
            return known
        if known is not None:
            raise SealedError(f"epoch {answer.epoch} has two envelopes: one of them is forged")
        key = open_key(sealed.envelope, self._key, device=self._device)
        try:
            if sealed.envelope.epoch != answer.epoch:
                raise SealedError("the envelope is of another epoch than the answer")
            return _Opened(key.sealing(), sealed.envelope, -1, answer.taken_at)
        finally:
            key.erase()

    def _opened(
        self, epoch: _Opened, answer: Capture | Classification, sealed: SealedEmbedding
    ) -> tuple[npt.NDArray[np.float32], Notes]:
        data = _associated_data(epoch.envelope, sealed.shape, answer.number, answer.taken_at)
        try:
            block = ChaCha20Poly1305(epoch.key).decrypt(
                _nonce(answer.number), base64.b64decode(sealed.block, validate=True), data
            )
            values = np.frombuffer(block[:-NOTES_BYTES], "<f4").astype(np.float32)
            return values.reshape(sealed.shape), Notes.model_validate_json(block[-NOTES_BYTES:])
        except (InvalidTag, OverflowError, ValidationError, ValueError):
            raise SealedError(
                f"capture {answer.number} of epoch {answer.epoch} cannot be opened: it was changed "
                "on its way"
            ) from None

    def _too_old(self, answer: Capture | Classification) -> bool:
        if answer.epoch in self._epochs or self._forgotten is None:
            return False
        return answer.taken_at <= self._forgotten

    def _remember(self, answer: Capture | Classification, epoch: _Opened) -> None:
        """Only once all of it was proven: nobody else can make an opener forget."""
        epoch.last, epoch.latest = answer.number, answer.taken_at
        self._epochs[answer.epoch] = epoch
        self._epochs.move_to_end(answer.epoch)
        self._device = epoch.envelope.device
        while len(self._epochs) > MOST_EPOCHS:
            _, oldest = self._epochs.popitem(last=False)
            self._forgotten = max(oldest.latest, self._forgotten or oldest.latest)


def _nonce(number: int) -> bytes:
    return number.to_bytes(12, "big")


def _associated_data(
    envelope: Envelope, shape: tuple[int, ...], number: int, taken_at: datetime
) -> bytes:
    fields = (
        *("veilcam sealed embedding", BLOCK_VERSION, envelope.device, envelope.epoch, number),
        *("sealed", list(shape), "float32", envelope.bundle, taken_at.isoformat()),
        receivers_digest(each.receiver for each in envelope.keys),
    )
    return json.dumps(fields, separators=(",", ":"), ensure_ascii=True).encode()
