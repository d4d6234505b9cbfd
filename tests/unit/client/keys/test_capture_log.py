"""Records of the capture log: what is signed, what each is bound to, and what they do not tell."""

from __future__ import annotations

import hashlib
import hmac
import json
from datetime import datetime, timedelta, timezone
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from pydantic import ValidationError
from tests.unit.client.sealing import AT, BUNDLE, NOTES, Device

from veilcam_client.keys.capture_log import (
    ID_DIGITS,
    answer_digest,
    calibration_digest,
    is_genuine,
    line_digest,
    line_of,
    logged_mask,
    mask_commitment,
    read_line,
    sign_head,
    sign_record,
)
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.wire import calibration
from veilcam_client.wire.captures import Capture, Classification, Embedding
from veilcam_client.wire.log import (
    Entry,
    LogDropped,
    LogGap,
    LoggedCapture,
    LogRecord,
    LogStarted,
    LogStopped,
)

CAPTURE = LoggedCapture(
    epoch="9f" * 16,
    number=3,
    taken_at=AT,
    mask="1a" * 32,
    tested_s=120,
    calibration=None,
    answer="2b" * 32,
)
ENTRIES: tuple[Entry, ...] = (
    CAPTURE,
    LogStarted(at=AT, after="cut"),
    LogStopped(at=AT),
    LogGap(answers=3),
    LogDropped(before=7),
)
ID = "c0ffee00" * 6
LEVELS: npt.NDArray[np.uint8] = np.arange(12, dtype=np.uint8).reshape(3, 4)


def record(device: Device, entry: Entry = CAPTURE) -> LogRecord:
    return sign_record(device, 5, "3c" * 32, entry)


SAID: dict[str, Any] = {"id": ID, "epoch": "9f" * 16, "number": 3, "taken_at": AT}


def classification(**others: Any) -> Classification:
    return Classification(**{**SAID, "label": "7", **others})


def test_signed_text_is_this_and_no_other() -> None:
    signed = []

    class Signer(Device):
        def sign(self, message: bytes) -> str:
            signed.append(message)
            return super().sign(message)

    device = Signer()
    record(device)
    sign_head(device, position=5, record="4d" * 32, oldest=1, missed=2, at=AT)
    assert [json.loads(message) for message in signed] == [
        [
            *("veilcam log record", 1, device.public, 5, "3c" * 32),
            [
                *("capture", "9f" * 16, 3, "2026-01-02T03:04:05+00:00", "1a" * 32, 120, None),
                "2b" * 32,
            ],
        ],
        [*("veilcam log head", 1, device.public, 5, "4d" * 32, 1, 2), "2026-01-02T03:04:05+00:00"],
    ]


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.kind)
def test_record_is_one_line_and_no_other_text_is_it(entry: Entry) -> None:
    made = record(Device(), entry)
    line = line_of(made)
    assert read_line(line) == made
    assert is_genuine(made)
    assert line_digest(line) == hashlib.sha256(line).hexdigest()
    for other in (
        line + b" ",
        line.replace(b":", b": ", 1),
        line.replace(b"{", b'{"more":1,', 1),
        line.replace(b"Z", b"+00:00"),
        line.replace(b'"version":1', b'"version":2'),
    ):
        if other != line:
            with pytest.raises(ValueError):  # noqa: PT011 - whatever pydantic calls it
                read_line(other)


@pytest.mark.long
@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.kind)
def test_every_bit_of_a_record_counts(entry: Entry, *, long_form: bool) -> None:
    """One bit of each byte, and in the long form all of them."""
    line = line_of(record(Device(), entry))
    for bit in range(0, 8 * len(line), 1 if long_form else 7):
        flipped = bytearray(line)
        flipped[bit // 8] ^= 1 << bit % 8
        try:
            assert not is_genuine(read_line(bytes(flipped))), bit
        except ValueError:
            continue


def test_every_field_of_a_head_is_signed_and_no_record_passes_for_one() -> None:
    device = Device()
    head = sign_head(device, position=5, record="4d" * 32, oldest=1, missed=2, at=AT)
    assert is_genuine(head)
    for change in (
        {"device": Device().public},
        {"position": 6},
        {"record": "4e" * 32},
        {"oldest": 0},
        {"missed": 0},
        {"at": AT + timedelta(seconds=1)},
        {"signature": "0" * 128},
    ):
        assert not is_genuine(head.model_copy(update=change)), change
    made = record(device)
    for change in (
        {"signature": head.signature},
        {"device": Device().public},
        {"device": "ff" * 32},  # no point of the curve
    ):
        assert not is_genuine(made.model_copy(update=change)), change


@pytest.mark.parametrize(
    "at",
    [
        AT.replace(tzinfo=None),
        AT.replace(microsecond=1),
        AT.astimezone(timezone(timedelta(hours=1))),
    ],
)
def test_times_of_records_are_whole_seconds_of_utc_and_ages_steps(at: datetime) -> None:
    with pytest.raises(ValidationError, match="whole second of UTC"):
        LogStopped(at=at)
    with pytest.raises(ValidationError):
        LoggedCapture(**{**dict(CAPTURE), "tested_s": 119})


def test_answer_is_known_again_and_every_part_of_it_counts() -> None:
    embedding = Embedding.from_array(np.arange(6, dtype=np.float32).reshape(2, 3), form="raw")
    answer = classification(scores={"7": 0.5, "1": 0.5}, confidence=0.5, embedding=embedding)
    digest = answer_digest(answer)
    assert digest == answer_digest(Classification.model_validate_json(answer.model_dump_json()))
    values = np.array([0.0, 1.0, 2.0, 3.0, 4.0, np.nextafter(np.float32(5), 6)], np.float32)
    other_values = Embedding.from_array(values.reshape(2, 3), form="raw")
    changed = [
        answer.model_copy(update=change)
        for change in (
            {"id": "c0ffee01" * 6},
            {"epoch": "9e" * 16},
            {"number": 4},
            {"taken_at": AT + timedelta(seconds=1)},
            {"label": "1"},
            {"confidence": None},
            {"scores": {"7": 0.4, "1": 0.6}},
            {"embedding": None},
            {"embedding": other_values},
            {"embedding": embedding.model_copy(update={"shape": (3, 2)})},
            {"embedding": embedding.model_copy(update={"form": "white"})},
        )
    ]
    assert len({digest, *map(answer_digest, changed)}) == 12
    capture = Capture(**SAID, embedding=embedding)
    assert answer_digest(capture) != answer_digest(classification(embedding=embedding))


def test_answer_is_hidden_by_an_id_that_stands_nowhere() -> None:
    """Ten labels are soon tried: what is not known is the id alone."""
    digest = answer_digest(classification())
    guesses = {answer_digest(classification(label=str(label), id="0" * 48)) for label in range(10)}
    assert digest not in guesses
    assert 4 * (ID_DIGITS - 16) == 128  # beyond what events tell of an id
    with pytest.raises(ValueError, match="hides nothing"):
        answer_digest(classification(id=ID[:16]))
    with pytest.raises(ValueError, match="was opened"):
        answer_digest(classification(notes=NOTES))


def test_calibration_is_named_by_all_that_it_says() -> None:
    [signed] = [each.signed for each in calibration.EXAMPLES if hasattr(each, "signed")]
    assert signed is not None
    again = signed.model_validate_json(signed.model_dump_json())
    other = signed.model_copy(update={"signature": "0" * 128})
    assert calibration_digest(signed) == calibration_digest(again) != calibration_digest(other)


def test_commitment_is_the_hmac_of_the_levels_under_the_epochs_own_key() -> None:
    key = EpochKey(bytes(range(32)), device="d7" * 32, bundle=BUNDLE)
    expected = hmac.digest(key.commitment(), bytes(range(12)), "sha256").hex()
    assert mask_commitment(key, LEVELS) == expected
    assert mask_commitment(key, np.asfortranarray(LEVELS)) == expected
    with pytest.raises(ValueError, match="use uint8"):
        mask_commitment(key, LEVELS.astype(np.int64))


def test_logged_mask_is_found_with_the_epochs_key_alone() -> None:
    key, other = (EpochKey.generate(device="d7" * 32, bundle=BUNDLE) for _ in range(2))
    masks = [LEVELS, LEVELS + 1, LEVELS + 2]
    entry = CAPTURE.model_copy(update={"mask": mask_commitment(key, LEVELS + 1)})
    assert logged_mask(entry, key, masks) == 1
    assert logged_mask(entry, key, masks[:1]) is None
    assert logged_mask(entry, other, masks) is None
