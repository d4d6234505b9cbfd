"""Check of a capture log: its signer, its changes, and its missing records."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

from veilcam_client.keys.capture_log import (
    NOTHING_BEFORE,
    answer_digest,
    is_genuine,
    line_digest,
    read_line,
)
from veilcam_client.wire.captures import Capture, Classification
from veilcam_client.wire.log import (
    LogDropped,
    LogGap,
    LoggedCapture,
    LogHead,
    LogRecord,
    LogStarted,
)

_SAID = {
    "cut": "the daemon had ended without a stop: what left last may be missing",
    "damage": "the camera could not read some of the records before",
    "loss": "the camera had lost its log, and began another",
}
"""Of what a start came after."""


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that does not hold."""

    wrong: str
    """What, in words."""
    line: int | None = None
    """Of the file, from 1 on; None: it is of no line."""
    position: int | None = None
    """That the record says it has; None: it is none, or cannot be read."""

    def __str__(self) -> str:
        if self.line is None:
            return self.wrong
        record = "" if self.position is None else f"record {self.position}, "
        return f"{record}line {self.line}: {self.wrong}"


@dataclass(slots=True)
class Examination:
    """Findings about a log."""

    device: str | None = None
    """Public key that its records must be signed with; None: there is no record."""
    first: int | None = None
    """Position of the first record."""
    last: int | None = None
    """Position of the last one."""
    records: int = 0
    captures: int = 0
    answer: int | None = None
    """Position of the record of the answer that was asked about."""
    findings: list[Finding] = field(default_factory=list)
    """What does not hold; none: all of it does."""
    said: list[str] = field(default_factory=list)
    """What the camera itself says is missing."""


@dataclass(slots=True)
class _Read:
    """A line, and what it is."""

    number: int
    digest: str
    record: LogRecord | None
    sound: bool = False
    """Whether the device signed it as it is."""


def examine(
    content: bytes,
    *,
    device: str | None = None,
    head: LogHead | None = None,
    answer: Capture | Classification | None = None,
) -> Examination:
    """Check every record of a log, and that each follows from the one before.

    Args:
        content: lines, as ``veilcam log`` writes them.
        device: public key that has to have signed it; that of the first record if None.
        head: head that must be the head of this log, fetched then or earlier.
        answer: answer that must be in it, as it left.

    Raises:
        ValueError: the answer was opened, or is of a camera that kept no log.
    """
    whole, _, rest = content.rpartition(b"\n")
    lines = [
        _Read(number, line_digest(line), _record(line))
        for number, line in enumerate(whole.split(b"\n") if whole else (), 1)
    ]
    known = [each.record for each in lines if each.record is not None]
    found = Examination(device=device or (known[0].device if known else None), records=len(lines))
    for each in lines:
        _check_line(each, found)
    if rest:
        found.findings.append(Finding("it is cut off", len(lines) + 1))
    _check_begin(lines, found)
    for before, each in pairwise(lines):
        _check_order(before, each, found)
    sound = [each for each in lines if each.sound]
    _tell(sound, found)
    if head is not None:
        _check_head(head, sound, found)
    if answer is not None:
        _check_answer(answer, sound, found)
    found.findings.sort(key=lambda each: (each.line is None, each.line or 0))
    return found


def _record(line: bytes) -> LogRecord | None:
    try:
        return read_line(line)
    except ValueError:
        return None


def _check_line(each: _Read, found: Examination) -> None:
    record = each.record
    if record is None:
        found.findings.append(Finding("this is no record: it was changed", each.number))
    elif record.device != found.device:
        wrong = f"it is of device {record.device[:12]}, not {str(found.device)[:12]}"
        found.findings.append(Finding(wrong, each.number, record.position))
    elif not is_genuine(record):
        wrong = "the device did not sign this: it was changed"
        found.findings.append(Finding(wrong, each.number, record.position))
    else:
        each.sound = True


def _check_begin(lines: list[_Read], found: Examination) -> None:
    """Check that a log begins at position 0, or where the camera dropped what was before."""
    if not lines:
        found.findings.append(Finding("there is no record"))
        return
    first = lines[0].record
    if first is None:
        return
    dropped = {
        each.record.entry.before
        for each in lines
        if each.sound and each.record is not None and isinstance(each.record.entry, LogDropped)
    }
    if first.position and first.position not in dropped:
        wrong = (
            f"{_missing(0, first.position)} before it, and no record says that the camera dropped "
            "them"
        )
    elif not first.position and first.previous != NOTHING_BEFORE:
        wrong = "it names one before, and there is none before position 0"
    else:
        return
    found.findings.append(Finding(wrong, 1, first.position))


def _check_order(before: _Read, each: _Read, found: Examination) -> None:
    if before.record is None or each.record is None:
        return
    due, position = before.record.position + 1, each.record.position
    if position > due:
        wrong = f"{_missing(due, position)} before it"
    elif position < due:
        wrong = f"it stands behind record {before.record.position}"
    elif each.record.previous != before.digest and before.sound:
        wrong = f"it follows from another record {before.record.position} than the one before it"
    else:
        return
    found.findings.append(Finding(wrong, each.number, position))


def _missing(begin: int, end: int) -> str:
    if end == begin + 1:
        return f"record {begin} is missing"
    return f"records {begin} to {end - 1} are missing"


def _tell(sound: list[_Read], found: Examination) -> None:
    """List the faults that the camera itself admits."""
    records = [each.record for each in sound if each.record is not None]
    if records:
        found.first, found.last = records[0].position, records[-1].position
    for record in records:
        match record.entry:
            case LoggedCapture():
                found.captures += 1
            case LogGap(answers=answers):
                found.said.append(f"record {record.position}: {answers} answers have no record")
            case LogDropped(before=before):
                found.said.append(
                    f"record {record.position}: the camera dropped all before record {before}"
                )
            case LogStarted(after=after) if after in _SAID:
                found.said.append(f"record {record.position}: {_SAID[after]}")


def _check_head(head: LogHead, sound: list[_Read], found: Examination) -> None:
    if head.missed:
        found.said.append(f"head: {head.missed} answers more have no record")
    digests = {each.record.position: each.digest for each in sound if each.record is not None}
    newest = -1 if found.last is None else found.last
    if head.device != found.device:
        wrong = f"it is of device {head.device[:12]}, not {str(found.device)[:12]}"
    elif not is_genuine(head):
        wrong = "the device did not sign this: it was changed"
    elif head.position > newest:
        wrong = f"{_missing(newest + 1, head.position + 1)} at the end of the file"
    elif found.first is not None and head.position < found.first:
        found.said.append(f"head: it is of record {head.position}, before the first of the file")
        return
    elif digests.get(head.position) != head.record:
        wrong = (
            f"it names another record {head.position}: the log was changed, or the camera's state "
            "was copied, restored or lost"
        )
    else:
        return
    found.findings.append(Finding(f"head: {wrong}"))


def _check_answer(answer: Capture | Classification, sound: list[_Read], found: Examination) -> None:
    digest = answer_digest(answer)
    others = []
    for each in sound:
        entry = None if each.record is None else each.record.entry
        if each.record is None or not isinstance(entry, LoggedCapture):
            continue
        if entry.answer == digest:
            found.answer = each.record.position
            return
        if (entry.epoch, entry.number) == (answer.epoch, answer.number):
            others.append(str(each.record.position))
    if others:
        wrong = f"record {', '.join(others)} is of its capture, and of another answer"
    else:
        wrong = "no record is of it"
    found.findings.append(Finding(f"answer: {wrong}"))
