"""A log, as a camera writes it."""

from __future__ import annotations

import builtins
from datetime import datetime, timedelta
from typing import TypeAlias

from tests.unit.client.sealing import AT, Device

from veilcam_client.keys.commitments import answer_digest
from veilcam_client.keys.log import NOTHING_BEFORE, line_digest, line_of, sign_record
from veilcam_client.wire.captures import Classification
from veilcam_client.wire.log import Kind, LogRecord, LogRecords

Entry: TypeAlias = tuple[Kind, datetime, dict[str, str | int]]


def event(kind: Kind, **facts: str | int) -> Entry:
    return kind, AT, facts


def answer(number: int) -> Classification:
    return Classification(
        id=f"{number:048x}",
        epoch="9f" * 16,
        number=number,
        taken_at=AT + timedelta(seconds=number),
        label=str(number % 10),
    )


def capture(number: int) -> Entry:
    told = answer(number)
    facts: dict[str, str | int] = {
        "epoch": told.epoch,
        "number": number,
        "mask": f"{number:064x}",
        "tested_s": 60,
        "answer": answer_digest(told),
    }
    return "capture", told.taken_at, facts


def signed(device: Device, position: int, previous: str, entry: Entry) -> LogRecord:
    kind, at, facts = entry
    return sign_record(device, position, previous, kind=kind, at=at, facts=facts)


LIFE: tuple[Entry, ...] = (
    event("start", after="nothing"),
    *map(capture, range(3)),
    event("gap", entries=2),
    capture(3),
    event("stop"),
    event("start", after="stop"),
    event("dropped", before=2),
    capture(4),
)


class Log:
    """Keeps records, and answers as a camera does.

    Args:
        device: that signs.
        entries: of its records.
    """

    def __init__(self, device: Device, entries: tuple[Entry, ...] = LIFE) -> None:
        self.device = device
        self.records: list[LogRecord] = []
        for entry in entries:
            self.append(entry)

    def append(self, entry: Entry) -> None:
        previous = line_digest(line_of(self.records[-1])) if self.records else NOTHING_BEFORE
        self.records.append(signed(self.device, len(self.records), previous, entry))

    def list(self, *, limit: int = 4, after: int | None = None) -> LogRecords:
        left = [each for each in self.records if after is None or each.position > after]
        more = len(left) > min(limit, 4)
        found = tuple(left[: min(limit, 4)])
        return LogRecords(records=found, next=found[-1].position if more else None)

    @property
    def lines(self) -> builtins.list[bytes]:
        return [line_of(each) for each in self.records]
