"""Log of a camera: its signed records, and their check without the camera.

A record is one line of JSON, and no other text says the same. The device signs all of it; the
SHA-256 of the whole line stands in the next one.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from hashlib import sha256

from veilcam_client.arguments import of_type
from veilcam_client.keys.envelopes import Signer, canonical, is_signed
from veilcam_client.wire.captures import Capture, Classification
from veilcam_client.wire.log import Kind, LogRecord

NOTHING_BEFORE = "0" * 64
"""Digest that the record at position 0 names as the one before."""
LOSSES = ("gap", "dropped", "damage")
"""Kinds of records by which a camera admits a loss."""


def sign_record(
    signer: Signer,
    position: int,
    previous: str,
    *,
    kind: Kind,
    at: datetime,
    facts: Mapping[str, str | int],
) -> LogRecord:
    """Sign one record; the arguments are its fields."""
    unsigned = LogRecord(
        device=signer.public,
        position=position,
        previous=previous,
        kind=kind,
        at=at,
        facts=facts,
        signature="0" * 128,
    )
    return unsigned.model_copy(update={"signature": signer.sign(_message(unsigned))})


def is_genuine(record: LogRecord) -> bool:
    """Return whether the device that a record names signed it."""
    return is_signed(record.device, record.signature, _message(record))


def line_of(record: LogRecord) -> bytes:
    """Return a record as one line, without its end."""
    return json.dumps(record.model_dump(mode="json"), separators=(",", ":")).encode()


def read_line(line: bytes) -> LogRecord | None:
    """Read a line without its end; None: it is not that of a record."""
    try:
        record = LogRecord.model_validate_json(line)
    except ValueError:
        return None
    return record if line_of(record) == line else None


def line_digest(line: bytes) -> str:
    """SHA-256 of a line without its end: 64 hexadecimal digits."""
    return sha256(line).hexdigest()


def _message(record: LogRecord) -> bytes:
    return canonical("veilcam log", record.model_dump(mode="json", exclude={"signature"}))


@dataclass(slots=True)
class Examination:
    """Findings about a log."""

    device: str | None
    """Public key that its records must be signed with; None: there is no record."""
    records: int
    captures: int = 0
    answer: int | None = None
    """Position of the record of the answer that was asked about."""
    findings: list[str] = field(default_factory=list)
    """Faults, each with its line; none: all of it holds."""
    said: list[str] = field(default_factory=list)
    """Losses that the camera itself admits."""


def verify_log(
    content: bytes,
    *,
    device: str | None = None,
    head: bytes | None = None,
    answer: Capture | Classification | None = None,
) -> Examination:
    """Check every record of a log, and that each follows from the one before.

    Args:
        content: content of a file that ``fetch_log`` wrote.
        device: public key that has to have signed it; that of the first record if None.
        head: earlier copy of the log, whose last line must be in it, or older than all of it.
        answer: answer that must be in the log, as it left.

    Raises:
        ValueError: the answer was opened, or is of a camera that kept no log.
    """
    of_type("content", content, bytes, "bytes")
    for name, given, kind in (("head", head, bytes), ("answer", answer, (Capture, Classification))):
        if given is not None:
            of_type(
                name, given, kind, "bytes" if kind is bytes else "a capture or a classification"
            )
    *lines, rest = content.split(b"\n")
    records = [read_line(line) for line in lines]
    found = Examination(device or next((each.device for each in records if each), None), len(lines))
    faults = [_line_fault(record, found.device) for record in records]
    sound = {
        record.position: (line_digest(line), record)
        for line, record, fault in zip(lines, records, faults, strict=True)
        if record is not None and fault is None
    }
    dropped = {each.facts.get("before") for _, each in sound.values() if each.kind == "dropped"}
    before: tuple[LogRecord | None, str] = None, ""
    for number, (line, record, fault) in enumerate(zip(lines, records, faults, strict=True), 1):
        place = f"line {number}" if record is None else f"record {record.position}, line {number}"
        order = _begin_fault(record, dropped) if number == 1 else _order_fault(*before, record)
        found.findings += [f"{place}: {wrong}" for wrong in (fault, order) if wrong is not None]
        before = record, line_digest(line) if fault is None else ""
    if rest or not lines:
        end = f"line {len(lines) + 1}: it is cut off" if rest else "there is no record"
        found.findings.append(end)
    for position, (_, record) in sound.items():
        found.captures += record.kind == "capture"
        if record.kind in LOSSES or record.facts.get("after") == "cut":
            words = ", ".join(f"{name} {value}" for name, value in record.facts.items())
            found.said.append(f"record {position}: {record.kind}, {words}")
    if head is not None:
        line = head.rstrip(b"\n").rpartition(b"\n")[2]
        _check_head(line, {where: digest for where, (digest, _) in sound.items()}, found)
    if answer is not None:
        _check_answer(answer, [record for _, record in sound.values()], found)
    return found


def _line_fault(record: LogRecord | None, device: str | None) -> str | None:
    if record is None:
        return "this is no record: it was changed"
    if record.device != device:
        return f"it is of device {record.device[:12]}, not {str(device)[:12]}"
    return None if is_genuine(record) else "the device did not sign this: it was changed"


def _begin_fault(record: LogRecord | None, dropped: set[str | int | None]) -> str | None:
    """Tell why a log does not begin here, where the camera did not drop what was before."""
    if record is None or (record.position and record.position in dropped):
        return None
    if record.position:
        missing = _missing(0, record.position)
        return f"{missing} before it, and no record says that the camera dropped them"
    wrong = "it names one before, and there is none before position 0"
    return None if record.previous == NOTHING_BEFORE else wrong


def _order_fault(before: LogRecord | None, digest: str, record: LogRecord | None) -> str | None:
    if before is None or record is None:
        return None
    due = before.position + 1
    if record.position > due:
        return f"{_missing(due, record.position)} before it"
    if record.position < due:
        return f"it stands behind record {before.position}"
    if digest and record.previous != digest:
        return f"it follows from another record {before.position} than the one before it"
    return None


def _check_head(line: bytes, digests: Mapping[int, str], found: Examination) -> None:
    head, newest = read_line(line), max(digests, default=-1)
    if head is None or _line_fault(head, found.device) is not None:
        found.findings.append("head: it is no record that this device signed")
    elif digests and head.position < min(digests):
        found.said.append(f"head: it is of record {head.position}, before the first of the file")
    elif head.position > newest:
        missing = _missing(newest + 1, head.position + 1)
        found.findings.append(f"head: {missing} at the end of the file")
    elif digests.get(head.position) != line_digest(line):
        found.findings.append(
            f"head: it is another record {head.position}: the log was changed, or the camera's "
            "state was copied, restored or lost"
        )


def _check_answer(
    answer: Capture | Classification, records: list[LogRecord], found: Examination
) -> None:
    # Late: it loads NumPy, which the daemon's token command need not wait for.
    from veilcam_client.keys.commitments import answer_digest  # noqa: PLC0415

    digest, of, others = answer_digest(answer), (answer.epoch, answer.number), []
    for record in records:
        if record.facts.get("answer") == digest:
            found.answer = record.position
            return
        if (record.facts.get("epoch"), record.facts.get("number")) == of:
            others.append(str(record.position))
    which = f"record {', '.join(others)} is of its capture, and of another answer"
    found.findings.append(f"answer: {which if others else 'no record is of it'}")


def _missing(begin: int, end: int) -> str:
    if end == begin + 1:
        return f"record {begin} is missing"
    return f"records {begin} to {end - 1} are missing"
