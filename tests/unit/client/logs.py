"""A log of captures, as a camera writes it."""

from __future__ import annotations

import builtins
from datetime import timedelta

from tests.unit.client.sealing import AT, Device

from veilcam_client.keys.capture_log import (
    NOTHING_BEFORE,
    answer_digest,
    line_digest,
    line_of,
    sign_head,
    sign_record,
)
from veilcam_client.wire.captures import Classification
from veilcam_client.wire.log import (
    Entry,
    LogDropped,
    LogGap,
    LoggedCapture,
    LogHead,
    LogRecord,
    LogRecords,
    LogStarted,
    LogStopped,
)


def answer(number: int) -> Classification:
    return Classification(
        id=f"{number:048x}",
        epoch="9f" * 16,
        number=number,
        taken_at=AT + timedelta(seconds=number),
        label=str(number % 10),
    )


def capture(number: int) -> LoggedCapture:
    told = answer(number)
    return LoggedCapture(
        epoch=told.epoch,
        number=number,
        taken_at=told.taken_at,
        mask=f"{number:064x}",
        tested_s=60,
        calibration=None,
        answer=answer_digest(told),
    )


LIFE: tuple[Entry, ...] = (
    LogStarted(at=AT, after="nothing"),
    *map(capture, range(3)),
    LogGap(answers=2),
    capture(3),
    LogStopped(at=AT),
    LogStarted(at=AT, after="stop"),
    LogDropped(before=2),
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
        self.records.append(sign_record(self.device, len(self.records), previous, entry))

    def list(self, *, limit: int = 4, after: int | None = None) -> LogRecords:
        left = [each for each in self.records if after is None or each.position > after]
        more = len(left) > min(limit, 4)
        found = tuple(left[: min(limit, 4)])
        return LogRecords(records=found, next=found[-1].position if more else None)

    def head(self, *, missed: int = 0) -> LogHead:
        return sign_head(
            self.device,
            position=self.records[-1].position,
            record=line_digest(line_of(self.records[-1])),
            oldest=self.records[0].position,
            missed=missed,
            at=AT,
        )

    @property
    def lines(self) -> builtins.list[bytes]:
        return [line_of(each) for each in self.records]
