"""Sealed embeddings: blocks of one size, whatever the camera saw.

ChaCha20-Poly1305 (RFC 8439) under a key of the epoch. The nonce is the number of the capture in its
epoch; the associated data are version, device, epoch, number, form, shape, dtype, bundle, time and
receivers, so that no block can be moved to another place. They vouch for the embedding and its
notes alone: the id, the label and the scores of an answer are what the connection says. All
receivers of an epoch share its key, so each of them could make blocks for the others.
"""

from __future__ import annotations

import base64
import hashlib
import re
import threading
from collections import OrderedDict
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

from veilcam_client.errors import ArgumentError, SealedError
from veilcam_client.keys.envelopes import canonical, open_key, receivers_digest
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.captures import Capture, Classification, Embedding, Notes, SealedEmbedding
from veilcam_client.wire.sealing import Envelope

BLOCK_VERSION = 1
NOTES_BYTES = 512
"""Of a block, after the values: the notes, filled up with spaces."""
MOST_EPOCHS = 16_384
"""So many epochs an opener remembers, to refuse what comes twice."""

AnswerT = TypeVar("AnswerT", Capture, Classification)


class Sealer:
    """Seals the embeddings of one epoch, each number once; any thread may ask.

    Args:
        key: key of the epoch.
        envelope: envelope that goes with every embedding.
    """

    def __init__(self, key: EpochKey, envelope: Envelope) -> None:
        self._key, self._envelope, self._last = key.sealing(), envelope, -1
        self._erased = False
        # A nonce used twice, or a key erased half way, would give everything away.
        self._lock = threading.Lock()

    def seal(
        self, number: int, taken_at: datetime, values: npt.NDArray[np.float32], notes: Notes
    ) -> SealedEmbedding:
        """Seal one embedding.

        Args:
            number: number of the capture in its epoch, above all that were sealed before.
            taken_at: time of the capture, to the second, UTC.
            values: float32, any shape.
            notes: notes that go with it.

        Raises:
            ValueError: the number was used, the key was erased, the time is no whole second of UTC,
                the values are no float32, or the notes are too long.
        """
        if values.dtype != np.float32:
            raise ValueError(f"values of {values.dtype} are not sealed: use float32")
        said = notes.model_dump_json().encode()
        if len(said) > NOTES_BYTES:
            raise ValueError(f"notes of {len(said)} bytes are too long: use {NOTES_BYTES}")
        block = bytearray(4 * values.size) + said.ljust(NOTES_BYTES)
        np.frombuffer(block, "<f4", values.size)[:] = values.ravel()
        data = _associated_data(self._envelope, values.shape, number, taken_at)
        nonce = _nonce(number)
        with self._lock:
            if self._erased:
                raise ValueError("the key of this epoch was erased")
            if number <= self._last:
                raise ValueError(f"capture {number} of this epoch was sealed already")
            self._last = number
            sealed = ChaCha20Poly1305(self._key).encrypt(nonce, block, data)
            block[:] = bytes(len(block))
        return SealedEmbedding(
            shape=values.shape,
            block=base64.b64encode(sealed).decode(),
            envelope=self._envelope,
        )

    def erase(self) -> None:
        """Overwrite the key: nothing is sealed any more. Twice does no harm."""
        with self._lock:
            self._key[:] = bytes(len(self._key))
            self._erased = True


@dataclass(slots=True)
class _Opened:
    """An epoch whose envelope was opened."""

    key: bytearray
    envelope: bytes
    """SHA-256 of the envelope: ten thousand whole ones would fill the memory."""
    last: int
    """Number that was opened last."""
    latest: datetime
    """When that was taken."""


class Opener:
    """Opens what one camera seals to one receiver, each number once and in their order.

    It remembers the epochs that it opened last; of one that it has forgotten, or never saw, nothing
    is taken that is older than what it forgot. A new opener has seen nothing: there, the time of an
    answer alone tells that it is an old one. An embedding that came unsealed is refused: anybody on
    the way could have put it there.

    Args:
        key: key of the receiver.
        device: public key of the camera, 64 hexadecimal digits; None: that of the first envelope
            that comes, from then on.
        epochs: number of epochs that are remembered.

    Raises:
        ArgumentError: ``device`` is no such key.
    """

    def __init__(
        self, key: ReceiverKey, device: str | None = None, *, epochs: int = MOST_EPOCHS
    ) -> None:
        if device is not None and re.fullmatch(r"[0-9a-f]{64}", str(device)) is None:
            raise ArgumentError(
                "device is not valid: use the camera's public key, 64 hexadecimal digits, as "
                "'veilcam receiver add' prints it"
            )
        self._key, self._device, self._most = key, device, epochs
        self._epochs: OrderedDict[str, _Opened] = OrderedDict()
        self._forgotten: datetime | None = None
        self._lock = threading.Lock()

    def open(self, answer: AnswerT) -> AnswerT:
        """Return the answer with its embedding as it was read, and with its notes.

        A classification without an embedding comes back without notes.

        Raises:
            SealedError: it is not sealed, not for this receiver or of another camera, it was
                changed, or it came before.
        """
        sealed = answer.embedding
        if sealed is None:
            return answer.model_copy(update={"notes": None})
        if not isinstance(sealed, SealedEmbedding):
            raise SealedError(
                f"this embedding came {sealed.form} where a sealed one was expected: pair a "
                "receiver with the camera, or give no key="
            )
        with self._lock:
            epoch = self._epoch(answer, sealed)
            embedding, notes = open_block(epoch.key, answer, sealed)
            if answer.number <= epoch.last or self._too_old(answer):
                raise SealedError(
                    f"capture {answer.number} of epoch {answer.epoch} came before, or later than "
                    "one that was taken after it"
                )
            self._remember(answer, sealed, epoch)
        return answer.model_copy(update={"embedding": embedding, "notes": notes})

    def _epoch(self, answer: Capture | Classification, sealed: SealedEmbedding) -> _Opened:
        """Return the epoch of an answer: known, or from its envelope."""
        envelope = hashlib.sha256(sealed.envelope.model_dump_json().encode()).digest()
        known = self._epochs.get(answer.epoch)
        if known is not None and known.envelope == envelope:
            return known
        if known is not None:
            raise SealedError(f"epoch {answer.epoch} has two envelopes: one of them is forged")
        key = open_key(sealed.envelope, self._key, device=self._device)
        try:
            return _Opened(key.sealing(), envelope, -1, answer.taken_at)
        finally:
            key.erase()

    def _too_old(self, answer: Capture | Classification) -> bool:
        if answer.epoch in self._epochs or self._forgotten is None:
            return False
        return answer.taken_at <= self._forgotten

    def _remember(
        self, answer: Capture | Classification, sealed: SealedEmbedding, epoch: _Opened
    ) -> None:
        """Only once all of it was proven: nobody else can make an opener forget."""
        epoch.last, epoch.latest = answer.number, answer.taken_at
        self._epochs[answer.epoch] = epoch
        self._epochs.move_to_end(answer.epoch)
        self._device = sealed.envelope.device
        while len(self._epochs) > self._most:
            _, oldest = self._epochs.popitem(last=False)
            self._forgotten = max(oldest.latest, self._forgotten or oldest.latest)
            oldest.key[:] = bytes(len(oldest.key))


def open_block(
    key: bytearray, answer: Capture | Classification, sealed: SealedEmbedding
) -> tuple[Embedding, Notes]:
    """Open the embedding of one answer, whether it came before or not.

    Args:
        key: key that embeddings of the epoch are sealed under.
        answer: answer as it came.
        sealed: sealed embedding of the answer.

    Raises:
        SealedError: it was changed.
    """
    try:
        if sealed.envelope.epoch != answer.epoch:
            raise ValueError("the envelope is of another epoch than the answer")
        block = base64.b64decode(sealed.block, validate=True)
        if base64.b64encode(block).decode() != sealed.block:
            raise ValueError("the last character has bits that mean nothing")
        data = _associated_data(sealed.envelope, sealed.shape, answer.number, answer.taken_at)
        opened = ChaCha20Poly1305(key).decrypt(_nonce(answer.number), block, data)
        values = np.frombuffer(opened[:-NOTES_BYTES], "<f4").astype(np.float32)
        embedding = Embedding.from_array(values.reshape(sealed.shape))
        return embedding, Notes.model_validate_json(opened[-NOTES_BYTES:])
    except (InvalidTag, OverflowError, ValueError):
        raise SealedError(
            f"capture {answer.number} of epoch {answer.epoch} cannot be opened: it was changed on "
            "its way"
        ) from None


def _nonce(number: int) -> bytes:
    return number.to_bytes(12, "big")


def _associated_data(
    envelope: Envelope, shape: tuple[int, ...], number: int, taken_at: datetime
) -> bytes:
    # One text for each moment: others would say the same, and open nothing.
    if taken_at.utcoffset() != timedelta(0) or taken_at.microsecond:
        raise ValueError(f"{taken_at.isoformat()} is not valid: use a whole second of UTC")
    return canonical(
        *("veilcam sealed embedding", BLOCK_VERSION, envelope.device, envelope.epoch, number),
        *("sealed", list(shape), "float32", envelope.bundle, taken_at.isoformat()),
        receivers_digest(each.receiver for each in envelope.keys),
    )
