"""Records of the capture log: how they are signed, chained, and bound to masks and answers.

A record is one line of JSON, and no other text says the same. The device signs its fields; the
SHA-256 of the whole line stands in the next one. Mask and answer are hidden: the mask by a key of
its epoch, which its receivers have, and the answer by its id, which stands in no record.
"""

from __future__ import annotations

import hmac
import json
from collections.abc import Iterable
from datetime import datetime
from hashlib import sha256

import numpy as np
import numpy.typing as npt
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from veilcam_client.keys.envelopes import Signer, canonical
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.wire.calibration import SignedCalibration
from veilcam_client.wire.captures import Capture, Classification
from veilcam_client.wire.log import LOG_VERSION, Entry, LoggedCapture, LogHead, LogRecord

NOTHING_BEFORE = "0" * 64
"""What the record at position 0 names as the one before."""
ID_DIGITS = 48
"""Of an answer's id, at random: 64 bits that name it, and 128 that hide it in the log."""
NAME_DIGITS = 16
"""Of an answer's id, which events tell."""


def sign_record(signer: Signer, position: int, previous: str, entry: Entry) -> LogRecord:
    """Sign one record.

    Args:
        signer: the device.
        position: position in the log.
        previous: digest of the line before.
        entry: entry of the record.
    """
    message = _record_message(signer.public, position, previous, entry)
    return LogRecord(
        device=signer.public,
        position=position,
        previous=previous,
        entry=entry,
        signature=signer.sign(message),
    )


def is_genuine(signed: LogRecord | LogHead) -> bool:
    """Return whether the device that a record or a head names signed it."""
    if isinstance(signed, LogHead):
        message = _head_message(signed)
    else:
        message = _record_message(signed.device, signed.position, signed.previous, signed.entry)
    try:
        public = Ed25519PublicKey.from_public_bytes(bytes.fromhex(signed.device))
        public.verify(bytes.fromhex(signed.signature), message)
    except (ValueError, InvalidSignature):
        return False
    return True


def sign_head(
    signer: Signer, *, position: int, record: str, oldest: int, missed: int, at: datetime
) -> LogHead:
    """Sign where the log ends; the arguments are the head's fields."""
    unsigned = LogHead(
        device=signer.public,
        position=position,
        record=record,
        oldest=oldest,
        missed=missed,
        at=at,
        signature="0" * 128,
    )
    return unsigned.model_copy(update={"signature": signer.sign(_head_message(unsigned))})


def line_of(record: LogRecord) -> bytes:
    """Return a record as one line, without its end."""
    return json.dumps(record.model_dump(mode="json"), separators=(",", ":")).encode()


def read_line(line: bytes) -> LogRecord:
    """Read a line without its end; raises :class:`ValueError` unless it is that of a record."""
    record = LogRecord.model_validate_json(line)
    if line_of(record) != line:
        raise ValueError("there is another text for this record")
    return record


def line_digest(line: bytes) -> str:
    """SHA-256 of a line without its end: 64 hexadecimal digits."""
    return sha256(line).hexdigest()


def answer_digest(answer: Capture | Classification) -> str:
    """SHA-256 of an answer as it left, 64 hexadecimal digits; its id is the salt.

    Raises:
        ValueError: its embedding was opened, or its id is too short to hide anything.
    """
    if answer.notes is not None:
        raise ValueError("this answer was opened: give it as it came, without key=")
    if len(answer.id) != ID_DIGITS:
        raise ValueError(f"an id of {len(answer.id)} digits hides nothing: use {ID_DIGITS}")
    said = answer.model_dump(mode="json", exclude_none=True, exclude={"embedding": {"values"}})
    values = getattr(answer.embedding, "values", ())
    # As numbers: to write them all out takes longer than to sign.
    data = sha256(np.asarray(values, "<f8").tobytes()).hexdigest()
    return sha256(canonical("veilcam answer", LOG_VERSION, said, data)).hexdigest()


def calibration_digest(calibration: SignedCalibration) -> str:
    """SHA-256 of a signed calibration, 64 hexadecimal digits."""
    said = calibration.model_dump(mode="json")
    return sha256(canonical("veilcam calibration", LOG_VERSION, said)).hexdigest()


def mask_commitment(key: EpochKey, levels: npt.NDArray[np.uint8]) -> str:
    """Commit to the mask of an epoch without telling it: 64 hexadecimal digits.

    Args:
        key: key of the epoch.
        levels: levels of the mask, (rows, columns), uint8.

    Raises:
        ValueError: the levels are of another type, or the key was erased.
    """
    if levels.dtype != np.uint8:
        raise ValueError(f"levels of {levels.dtype} are not valid: use uint8")
    derived = key.commitment()
    try:
        return hmac.digest(derived, levels.tobytes(), "sha256").hex()
    finally:
        derived[:] = bytes(len(derived))


def logged_mask(
    entry: LoggedCapture, key: EpochKey, masks: Iterable[npt.NDArray[np.uint8]]
) -> int | None:
    """Return which of ``masks`` a record commits to, from 0 on; None: none of them.

    Args:
        entry: entry of the record.
        key: key of its epoch, from the envelope of a sealed answer
            (:func:`~veilcam_client.keys.envelopes.open_key`).
        masks: levels, (rows, columns), uint8: those of the bundle, or the one drawn from ``key``.
    """
    for index, levels in enumerate(masks):
        if hmac.compare_digest(mask_commitment(key, levels), entry.mask):
            return index
    return None


def _record_message(device: str, position: int, previous: str, entry: Entry) -> bytes:
    said = [_told(value) for _, value in entry]
    return canonical("veilcam log record", LOG_VERSION, device, position, previous, said)


def _head_message(head: LogHead) -> bytes:
    said = [_told(value) for name, value in head if name != "signature"]
    return canonical("veilcam log head", *said)


def _told(value: object) -> object:
    return value.isoformat() if isinstance(value, datetime) else value
