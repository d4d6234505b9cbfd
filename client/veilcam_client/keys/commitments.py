"""Commitments to masks, answers and calibrations, as the log of a camera names them.

Mask and answer are hidden: the mask by a key of its epoch, which its receivers have, and the answer
by its id, which stands in no record.
"""

from __future__ import annotations

import hmac
from collections.abc import Iterable
from hashlib import sha256

import numpy as np
import numpy.typing as npt

from veilcam_client.keys.envelopes import canonical
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.numbers import erasable
from veilcam_client.wire.calibration import SignedCalibration
from veilcam_client.wire.captures import Capture, Classification
from veilcam_client.wire.log import LogRecord

ID_DIGITS = 48
"""Of an answer's id, at random: 64 bits that name it, and 128 that hide it in the log."""
NAME_DIGITS = 16
"""Of an answer's id, which events tell."""


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
    data = sha256(erasable(np.asarray(values), "<f8").data).hexdigest()
    return sha256(canonical("veilcam answer", 1, said, data)).hexdigest()


def calibration_digest(calibration: SignedCalibration) -> str:
    """SHA-256 of a signed calibration, 64 hexadecimal digits."""
    said = calibration.model_dump(mode="json")
    return sha256(canonical("veilcam calibration", 1, said)).hexdigest()


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
    record: LogRecord, key: EpochKey, masks: Iterable[npt.NDArray[np.uint8]]
) -> int | None:
    """Return which of ``masks`` a record commits to, from 0 on; None: none of them.

    Args:
        record: record of a capture.
        key: key of its epoch, from the envelope of a sealed answer
            (:func:`~veilcam_client.keys.envelopes.open_key`).
        masks: levels, (rows, columns), uint8: those of the bundle, or the one drawn from ``key``.
    """
    for index, levels in enumerate(masks):
        if hmac.compare_digest(mask_commitment(key, levels), str(record.facts.get("mask"))):
            return index
    return None
