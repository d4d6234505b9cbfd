"""Records of the log: what is signed, and what is found of a log that was changed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from datetime import datetime, timedelta, timezone
from typing import Any

import pytest
from pydantic import ValidationError
from tests.unit.client.logs import LIFE, Entry, Log, answer, capture, event, signed
from tests.unit.client.sealing import AT, Device

from veilcam_client.keys.log import (
    Examination,
    is_genuine,
    line_digest,
    line_of,
    read_line,
    verify_log,
)
from veilcam_client.wire.log import LogRecord

ENTRIES = (
    capture(3),
    event("start", after="cut"),
    event("request", action="GET /caf\u00e9/\x1b", status=404, label='a "b"'),
    event("stop"),
)


def record(device: Device, entry: Entry = ENTRIES[0]) -> LogRecord:
    return signed(device, 5, "3c" * 32, entry)


def test_signed_text_is_this_and_no_other() -> None:
    signed = []

    class Signer(Device):
        def sign(self, message: bytes) -> str:
            signed.append(message)
            return super().sign(message)

    device = Signer()
    record(device, event("gap", entries=3))
    at = "2026-01-02T03:04:05Z"
    assert json.loads(signed[0]) == [
        "veilcam log",
        {
            "version": 1,
            "device": device.public,
            "position": 5,
            "previous": "3c" * 32,
            "kind": "gap",
            "at": at,
            "facts": {"entries": 3},
        },
    ]


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry[0])
def test_record_is_one_line_and_no_other_text_is_it(entry: Entry) -> None:
    made = record(Device(), entry)
    line = line_of(made)
    assert b"\n" not in line
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
        assert read_line(other) is None


@pytest.mark.long
@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry[0])
def test_every_bit_of_a_record_counts(entry: Entry, *, long_form: bool) -> None:
    """One bit of each byte, and in the long form all of them."""
    line = line_of(record(Device(), entry))
    for bit in range(0, 8 * len(line), 1 if long_form else 7):
        flipped = bytearray(line)
        flipped[bit // 8] ^= 1 << bit % 8
        read = read_line(bytes(flipped))
        assert read is None or not is_genuine(read), bit


def test_record_of_another_signature_is_not_genuine() -> None:
    made = record(Device())
    for change in (
        {"signature": record(Device()).signature},
        {"device": Device().public},
        {"device": "ff" * 32},  # no point of the curve
        {"position": 6},
        {"previous": "3d" * 32},
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
def test_times_of_records_are_whole_seconds_of_utc(at: datetime) -> None:
    with pytest.raises(ValidationError, match="whole second of UTC"):
        record(Device(), ("stop", at, {}))


DEVICE = Device()
LOG = Log(DEVICE)
LINES = LOG.lines
HEAD = LINES[-1]


def content(lines: list[bytes]) -> bytes:
    return b"".join(line + b"\n" for line in lines)


def found(lines: list[bytes], **others: Any) -> list[str]:
    return verify_log(content(lines), **others).findings


def test_whole_log_holds() -> None:
    examined = verify_log(content(LINES), device=DEVICE.public, head=HEAD, answer=answer(3))
    assert examined == Examination(
        device=DEVICE.public,
        records=10,
        captures=5,
        answer=5,
        findings=[],
        said=[
            "record 4: gap, entries 2",
            "record 8: dropped, before 2",
        ],
    )


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        (event("start", after="cut"), ["record 0: start, after cut"]),
        (event("start", after="stop"), []),
        (event("damage", lost="its end"), ["record 0: damage, lost its end"]),
    ],
)
def test_loss_that_the_camera_admits_is_told(entry: Entry, said: list[str]) -> None:
    assert verify_log(content(Log(DEVICE, (entry,)).lines)).said == said


def test_empty_file_is_no_log() -> None:
    examined = verify_log(b"")
    assert examined.findings == ["there is no record"]
    assert (examined.device, examined.records) == (None, 0)


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        (lambda line: line.replace(b'"number":1', b'"number":2'), "the device did not sign this"),
        (lambda line: line.replace(b"label", b"lebal")[:-1], "this is no record"),
        (lambda line: line.replace(b":", b": ", 1), "this is no record"),
        (lambda line: line[:-4] + b'0"}', "this is no record"),
    ],
)
def test_changed_record_is_named_once(change: Callable[[bytes], bytes], wrong: str) -> None:
    lines = [*LINES[:2], change(LINES[2]), *LINES[3:]]
    [finding] = verify_log(content(lines)).findings
    of = "record 2, " if "sign" in wrong else ""
    assert finding == f"{of}line 3: {wrong}: it was changed"


DROPPED = "missing before it, and no record says that the camera dropped them"
OTHER = Log(DEVICE, (*LIFE[:4], event("gap", entries=1), *LIFE[5:])).lines
FORGED = LINES[8].replace(b'"before":2', b'"before":3')


@pytest.mark.parametrize(
    ("lines", "findings"),
    [
        (LINES[2:], []),
        (LINES[1:], [f"record 1, line 1: record 0 is {DROPPED}"]),
        (LINES[3:], [f"record 3, line 1: records 0 to 2 are {DROPPED}"]),
        (LINES[:-1], []),
        ([*LINES[:4], *LINES[5:]], ["record 5, line 5: record 4 is missing before it"]),
        ([*LINES[:4], *LINES[7:]], ["record 7, line 5: records 4 to 6 are missing before it"]),
        (
            [*LINES[:3], LINES[4], LINES[3], *LINES[5:]],
            [
                "record 4, line 4: record 3 is missing before it",
                "record 3, line 5: it stands behind record 4",
                "record 5, line 6: record 4 is missing before it",
            ],
        ),
        ([*LINES[:4], *LINES[3:]], ["record 3, line 5: it stands behind record 3"]),
        (
            [*LINES[:5], *OTHER[5:]],
            ["record 5, line 6: it follows from another record 4 than the one before it"],
        ),
        (
            [line_of(signed(DEVICE, 0, "ab" * 32, event("dropped", before=0)))],
            ["record 0, line 1: it names one before, and there is none before position 0"],
        ),
        (
            # Only what the device signed says that it dropped records.
            [*LINES[3:8], FORGED, LINES[9]],
            [
                f"record 3, line 1: records 0 to 2 are {DROPPED}",
                "record 8, line 6: the device did not sign this: it was changed",
            ],
        ),
    ],
)
def test_record_that_is_missing_misplaced_or_foreign_is_named(
    lines: list[bytes], findings: list[str]
) -> None:
    assert found(lines) == findings


def test_record_of_another_device_is_found() -> None:
    other, stranger = Device(), Log(Device())
    told = found(LINES, device=other.public)
    assert len(told) == 10
    assert told[0] == (
        f"record 0, line 1: it is of device {DEVICE.public[:12]}, not {other.public[:12]}"
    )
    mixed = found([*LINES[:9], stranger.lines[9]])
    assert mixed[0].startswith(f"record 9, line 10: it is of device {stranger.device.public[:12]}")


@pytest.mark.parametrize("cut", [1, 5])
def test_half_a_last_line_is_found(cut: int) -> None:
    assert verify_log(content(LINES)[:-cut]).findings == ["line 10: it is cut off"]


def test_newest_record_may_be_missing_without_a_head_alone() -> None:
    assert found(LINES[:-1]) == []
    assert found(LINES[:-1], head=HEAD) == ["head: record 9 is missing at the end of the file"]
    told = ["head: records 7 to 9 are missing at the end of the file"]
    assert found(LINES[:7], head=HEAD) == told


def test_earlier_head_holds_as_long_as_its_record_is_there() -> None:
    assert found(LINES, head=LINES[1]) == []
    assert found(LINES[2:], head=LINES[1]) == []
    said = verify_log(content(LINES[2:]), head=LINES[1]).said
    assert said[-1] == "head: it is of record 1, before the first of the file"


def test_head_of_another_log_is_found() -> None:
    forked = Log(DEVICE, (*LIFE[:-1], event("stop")))
    [wrong] = found(LINES, head=forked.lines[-1])
    assert wrong.startswith("head: it is another record 9: the log was changed, or the camera's")
    for other in (Log(Device()).lines[-1], HEAD.replace(b'"tested_s":60', b'"tested_s":0'), b"{}"):
        assert found(LINES, head=other) == ["head: it is no record that this device signed"]
    assert found([], head=HEAD)[0] == "there is no record"


def test_answer_is_found_or_not() -> None:
    assert verify_log(content(LINES), answer=answer(4)).answer == 9
    assert found(LINES, answer=answer(5)) == ["answer: no record is of it"]
    other = answer(4).model_copy(update={"label": "7"})
    assert found(LINES, answer=other) == [
        "answer: record 9 is of its capture, and of another answer"
    ]
    changed = [*LINES[:-1], LINES[-1].replace(b'"tested_s":60', b'"tested_s":0')]
    assert verify_log(content(changed), answer=answer(4)).answer is None
    with pytest.raises(ValueError, match="hides nothing"):
        verify_log(content(LINES), answer=answer(4).model_copy(update={"id": "c0ffee"}))
