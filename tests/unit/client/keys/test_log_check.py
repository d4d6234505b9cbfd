"""What is found of a log that was changed, and what is not."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from tests.unit.client.logs import LIFE, Log, answer
from tests.unit.client.sealing import AT, Device

from veilcam_client.keys.capture_log import line_of, sign_record
from veilcam_client.keys.log_check import Examination, Finding, examine
from veilcam_client.wire.log import LogDropped, LogGap, LogStarted, LogStopped

DEVICE = Device()
LOG = Log(DEVICE)
LINES = LOG.lines


def content(lines: list[bytes]) -> bytes:
    return b"".join(line + b"\n" for line in lines)


def found(lines: list[bytes], **others: Any) -> list[str]:
    return [str(each) for each in examine(content(lines), **others).findings]


def test_whole_log_holds() -> None:
    examined = examine(content(LINES), device=DEVICE.public, head=LOG.head(), answer=answer(3))
    assert examined == Examination(
        device=DEVICE.public,
        first=0,
        last=9,
        records=10,
        captures=5,
        answer=5,
        findings=[],
        said=[
            "record 4: 2 answers have no record",
            "record 8: the camera dropped all before record 2",
        ],
    )


@pytest.mark.parametrize("after", ["cut", "damage", "loss"])
def test_start_after_a_loss_is_told(after: Any) -> None:
    said = examine(content(Log(DEVICE, (LogStarted(at=AT, after=after),)).lines)).said
    assert len(said) == 1
    assert said[0].startswith("record 0: the ")


def test_empty_file_is_no_log() -> None:
    examined = examine(b"")
    assert [str(each) for each in examined.findings] == ["there is no record"]
    assert (examined.device, examined.first, examined.records) == (None, None, 0)


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
    [finding] = examine(content(lines)).findings
    assert finding.line == 3
    assert finding.position == (2 if "sign" in wrong else None)
    assert finding.wrong == f"{wrong}: it was changed"


DROPPED = "missing before it, and no record says that the camera dropped them"
OTHER = Log(DEVICE, (*LIFE[:4], LogGap(answers=1), *LIFE[5:])).lines
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
            [line_of(sign_record(DEVICE, 0, "ab" * 32, LogDropped(before=0)))],
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
    assert examine(content(LINES)[:-cut]).findings == [Finding("it is cut off", 10)]


def test_newest_record_may_be_missing_without_a_head_alone() -> None:
    head = LOG.head()
    assert found(LINES[:-1], head=head) == ["head: record 9 is missing at the end of the file"]
    told = ["head: records 7 to 9 are missing at the end of the file"]
    assert found(LINES[:7], head=head) == told


def test_earlier_head_holds_as_long_as_its_record_is_there() -> None:
    earlier = Log(DEVICE, LIFE[:2]).head()
    assert found(LINES, head=earlier) == []
    assert found(LINES[2:], head=earlier) == []
    said = examine(content(LINES[2:]), head=earlier).said
    assert said[-1] == "head: it is of record 1, before the first of the file"
    told = examine(content(LINES), head=LOG.head(missed=3)).said
    assert told[-1] == "head: 3 answers more have no record"


def test_head_of_another_log_is_found() -> None:
    forked = Log(DEVICE, (*LIFE[:-1], LogStopped(at=AT)))
    [wrong] = found(LINES, head=forked.head())
    assert wrong.startswith("head: it names another record 9: the log was changed, or the camera's")
    [wrong] = found(LINES, head=Log(Device()).head())
    assert wrong.startswith("head: it is of device ")
    forged = LOG.head().model_copy(update={"oldest": 1})
    assert found(LINES, head=forged) == ["head: the device did not sign this: it was changed"]
    assert found([], head=LOG.head())[0] == "there is no record"


def test_answer_is_found_or_not() -> None:
    assert examine(content(LINES), answer=answer(4)).answer == 9
    assert found(LINES, answer=answer(5)) == ["answer: no record is of it"]
    other = answer(4).model_copy(update={"label": "7"})
    assert found(LINES, answer=other) == [
        "answer: record 9 is of its capture, and of another answer"
    ]
    changed = [*LINES[:-1], LINES[-1].replace(b'"tested_s":60', b'"tested_s":0')]
    assert examine(content(changed), answer=answer(4)).answer is None
    with pytest.raises(ValueError, match="hides nothing"):
        examine(content(LINES), answer=answer(4).model_copy(update={"id": "c0ffee"}))
