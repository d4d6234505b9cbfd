"""The capture log: who took which captures in what order, signed, and chained by hash.

A record is with the kernel before its answer leaves, and on the disk before anybody is shown it.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import structlog

from veilcam_client.keys.capture_log import (
    NOTHING_BEFORE,
    is_genuine,
    line_digest,
    line_of,
    read_line,
    sign_head,
    sign_record,
)
from veilcam_client.keys.envelopes import Signer
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
from veilcam_server.errors import ProblemError, StorageError
from veilcam_server.sealing.segments import Ending, Segments, lines_of, position_of
from veilcam_server.system.state_file import Report, log_fault
from veilcam_server.system.state_folder import read_file

FOLDER = "capture-log"
"""Of the segments in the state directory."""

log = structlog.get_logger()


class CaptureLog:
    """The log of one device, from one life of the daemon to the next; any thread may use it.

    Nothing of it keeps an answer from leaving: what is damaged is set aside, what cannot be written
    is counted, and the chain goes on with a record that says so.

    Args:
        segments: segments that hold the lines.
        signer: the device.
    """

    def __init__(self, segments: Segments, signer: Signer) -> None:
        self._segments, self._signer = segments, signer
        self._report: Report = log_fault
        self._lock = threading.Lock()
        self._recovered = self._closed = self._failing = False
        self._started: LogStarted | None = None
        self._position, self._digest, self._missed = -1, NOTHING_BEFORE, 0

    @classmethod
    def of(cls, state_dir: Path, signer: Signer) -> CaptureLog:
        """Open the log in a daemon's state directory."""
        return cls(Segments(state_dir / FOLDER), signer)

    def begin(self, report: Report) -> None:
        """Go on where the log ended; what cannot be done now is tried again with the next answer.

        Args:
            report: takes what was damaged, and that it cannot be written.
        """
        self._report = report
        with self._lock:
            try:
                self._begin()
            except OSError as error:
                self._fail(error)

    def append(self, entry: LoggedCapture) -> None:
        """Sign and write what an answer is, before it leaves; where that fails, count it."""
        with self._lock:
            if self._closed:
                return
            try:
                self._begin()
                self._write(entry)
            except OSError as error:
                self._missed += 1
                self._fail(error)

    def head(self) -> LogHead:
        """Sign where the log ends now; all until there is on the disk.

        Raises:
            StorageError: it cannot be made durable.
        """
        with self._shown():
            position, digest, missed = self._position, self._digest, self._missed
            oldest = self._segments.oldest
        return sign_head(
            self._signer,
            position=position,
            record=digest,
            oldest=oldest,
            missed=missed,
            at=_now(),
        )

    def records(self, after: int | None, limit: int) -> LogRecords:
        """Read records in their order; all of them are on the disk. Damaged ones are left out.

        Args:
            after: position after which records are wanted; None: from the oldest on.
            limit: greatest number of records.

        Raises:
            StorageError: they cannot be made durable, or read.
        """
        begin = 0 if after is None else after + 1
        with self._shown():
            files = self._segments.files(begin)
        found: list[LogRecord] = []
        for path, size in files:
            try:
                content = read_file(path)[:size]
            except FileNotFoundError:  # it was the oldest, and was dropped meanwhile
                continue
            except OSError as error:
                raise _refused(error) from None
            for line in lines_of(content):
                position = position_of(line)
                if position is None or position < begin or (record := _record(line)) is None:
                    continue
                found.append(record)
                if len(found) == limit:
                    return LogRecords(records=tuple(found), next=position)
        return LogRecords(records=tuple(found))

    def close(self) -> None:
        """Write that the daemon stops, and flush all; twice does no harm."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            try:
                self._begin()
                self._write(LogStopped(at=_now()))
                _flush(self._segments.flushable())
            except OSError as error:
                self._fail(error)
            self._segments.close()

    @contextmanager
    def _shown(self) -> Iterator[None]:
        """Look at the log within; after that, all of it until then is on the disk."""
        try:
            with self._lock:
                self._begin()
                yield
                flushable = self._segments.flushable()
            # Without the lock: no answer waits for the disk.
            _flush(flushable)
        except OSError as error:
            raise _refused(error) from None

    def _begin(self) -> None:
        """Find the end of the log, and write that it goes on; raises :class:`OSError`."""
        if not self._recovered:
            self._started = LogStarted(at=_now(), after=self._recover())
            self._recovered = True
        if self._started is not None:
            self._put(self._started)
            self._started = None

    def _recover(self) -> Literal["nothing", "stop", "cut", "damage", "loss"]:
        """Go on from the newest record that holds; returns what came before."""
        ending = self._segments.recover(self._is_own)
        if ending.torn or ending.breaks:
            self._report(ProblemError("state_lost", _damage(ending, self._segments.aside.name)))
        if ending.last is None:
            return "loss" if ending.torn else "nothing"
        last = read_line(ending.last)
        self._position, self._digest = last.position, line_digest(ending.last)
        if ending.torn or ending.breaks:
            return "damage"
        return "stop" if isinstance(last.entry, LogStopped) else "cut"

    def _write(self, entry: Entry) -> None:
        """Write what there is to say before, and then an entry; raises :class:`OSError`."""
        if self._segments.surplus:
            self._put(LogDropped(before=self._segments.surplus))
            self._segments.drop()
        if self._missed:
            self._put(LogGap(answers=self._missed))
            log.info("capture log can be written again", missed=self._missed)
            self._missed = 0
        self._put(entry)
        self._failing = False

    def _put(self, entry: Entry) -> None:
        position = self._position + 1
        line = line_of(sign_record(self._signer, position, self._digest, entry))
        self._segments.append(position, line)
        self._position, self._digest = position, line_digest(line)

    def _fail(self, error: OSError) -> None:
        if not self._failing:
            self._report(_refused(error))
        self._failing = True

    def _is_own(self, line: bytes) -> bool:
        record = _record(line)
        return record is not None and record.device == self._signer.public and is_genuine(record)


def _record(line: bytes) -> LogRecord | None:
    try:
        return read_line(line)
    except ValueError:
        return None


def _damage(ending: Ending, aside: str) -> str:
    """Say in words which line is damaged, and what follows from it."""
    if ending.last is None:
        return f"the capture log is lost, and a new one begins; what was left is in {aside}"
    parts = []
    if ending.torn:
        parts.append(f"its end is damaged and was set aside in {aside}")
    if ending.breaks:
        parts.append(f"records are damaged or missing in {ending.breaks} places")
    return f"the capture log goes on, but {', and '.join(parts)}"


def _refused(error: OSError) -> StorageError:
    return StorageError(
        f"the capture log cannot be written ({error.strerror}): check the state directory's disk; "
        "it will say how many answers left meanwhile"
    )


def _flush(descriptor: int | None) -> None:
    if descriptor is not None:
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _now() -> datetime:
    return datetime.now(UTC).replace(microsecond=0)
