"""Log of what left this camera, and who changed it: signed lines, chained by hash."""

from __future__ import annotations

import errno
import os
import re
import shutil
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from veilcam_client.keys.envelopes import Signer
from veilcam_client.keys.log import (
    NOTHING_BEFORE,
    is_genuine,
    line_digest,
    line_of,
    read_line,
    sign_record,
)
from veilcam_client.wire.log import Kind, LogRecord, LogRecords
from veilcam_optics.files import sync_folder
from veilcam_server.errors import ProblemError, StorageError
from veilcam_server.system.state_file import Report, lock_within, log_fault, make_directory
from veilcam_server.system.state_folder import open_file, read_file

FOLDER = "log"
"""Folder of the log in the state directory."""
FILE_BYTES, FILES_KEPT = 4 << 20, 16
"""Size of one file, and files that stay: 64 MiB, some 90,000 captures."""
REFUSED_SHARE = 8
"""Refused requests take at most one of so many parts of a file."""
PATIENCE = 0.5
"""How long another process may write [s]."""
_NAME = re.compile(r"\d{20}\.jsonl")
_START = re.compile(
    rb'\{"version":1,"device":"[0-9a-f]{64}","position":(\d+),"previous":"([0-9a-f]{64})",'
    rb'"kind":"([a-z]+)"'
)


class _Entry(NamedTuple):
    kind: Kind
    at: datetime
    facts: Mapping[str, str | int]


class Log:
    """Log of one device, from one life of the daemon to the next.

    Any thread and any process may write it. Each file is named by the position of its first line.
    A record is with the kernel before its answer leaves; one that must be durable, and all that
    anybody is shown, is on the disk before. A full disk stops no answer: what cannot be written is
    counted, and told by a ``gap``. What is damaged at the end is set aside, and the chain goes on.

    Args:
        folder: folder of the files; made as soon as there is a record.
        signer: the device.
        report: takes what was damaged, and that it cannot be written.
        limit: size of one file [bytes].
        kept: number of files that stay.
    """

    def __init__(
        self,
        folder: Path,
        signer: Signer,
        report: Report = log_fault,
        *,
        limit: int = FILE_BYTES,
        kept: int = FILES_KEPT,
    ) -> None:
        self.missed = 0
        """Entries that could not be written."""
        self._folder, self._signer, self._report = folder, signer, report
        self._limit, self._kept = limit, kept
        self._aside = folder.with_name(f"{folder.name}.damaged")
        self._guard = threading.Lock()
        self._failing = self._closed = self._begun = self._known = self._torn = False
        self._gap = self._untold = self._refused = self._size = 0
        self._damage, self._after = "", "nothing"
        self._file: int | None = None
        self._names: list[str] = []
        self._position, self._digest = -1, NOTHING_BEFORE

    def begin(self, report: Report) -> None:
        """Write that the daemon starts; what cannot be done now is done with the next entry.

        Args:
            report: takes faults from now on.
        """
        self._report, self._begun = report, True
        with suppress(StorageError):
            self._write(None)

    def append(
        self,
        kind: Kind,
        facts: Mapping[str, str | int],
        *,
        at: datetime | None = None,
        durable: bool = False,
    ) -> None:
        """Write an entry; where that fails, count it.

        Args:
            kind: kind of the record.
            facts: facts of the record.
            at: time to the second; now if None.
            durable: True: the record is on the disk at return, or this raises.

        Raises:
            StorageError: a record that must be durable is not.
        """
        try:
            self._write(_Entry(kind, at or _now(), facts), durable=durable)
        except StorageError:
            if durable:
                raise

    def require(self) -> None:
        """Raise :class:`StorageError` while nothing can be written, before anything is changed."""
        if self._failing:
            self._write(None, durable=True)

    def records(self, after: int | None, limit: int, *, newest: bool = False) -> LogRecords:
        """Read records in their order; all of them are on the disk. Damaged ones are left out.

        Args:
            after: position after which records are wanted; None: from the oldest on.
            limit: greatest number of records.
            newest: True: the newest records instead.

        Raises:
            StorageError: they cannot be made durable, or read.
        """
        names, last = self._write(None, durable=True, reading=True)
        begin = 0 if after is None else after + 1
        begin = max(begin, last + 1 - limit) if newest else begin
        found: list[LogRecord] = []
        for number, name in enumerate(names, 1):
            if number < len(names) and int(names[number][:20]) <= begin:
                continue
            try:
                lines = read_file(self._folder / name).split(b"\n")[:-1]
            except FileNotFoundError:  # it was the oldest, and was dropped meanwhile
                continue
            except OSError as error:
                raise _refused(error) from None
            for line in lines:
                start = _START.match(line)
                if start is None or not begin <= int(start[1]) <= last:
                    continue
                if (record := read_line(line)) is not None:
                    found.append(record)
                if len(found) == limit:
                    position = found[-1].position
                    more = position if position < last else None
                    return LogRecords(records=tuple(found), next=more)
        return LogRecords(records=tuple(found))

    def close(self) -> None:
        """Write that the daemon stops, and flush all; twice does no harm."""
        if self._begun and not self._closed:
            with suppress(StorageError):
                self.append("stop", _told(refused=self._untold), durable=True)
        self._closed = True
        self._close_file()

    def _write(
        self, entry: _Entry | None, *, durable: bool = False, reading: bool = False
    ) -> tuple[list[str], int]:
        """Write what is owed, and then an entry; or count it, and raise :class:`StorageError`.

        Returns:
            Names of the files, and the newest position.
        """
        flush, refused = None, entry is not None and entry.kind == "refused"
        try:
            with self._guard:
                if refused and self._refused > self._limit // REFUSED_SHARE:
                    self._untold += 1
                elif not self._closed:
                    with self._alone():
                        if not reading:
                            self._put_all(entry)
                        flush = os.dup(self._file) if durable and self._file is not None else None
                end = self._names, self._position
            # Without the lock: no answer waits for the disk.
            if flush is not None:
                with os.fdopen(flush) as held:
                    os.fsync(held.fileno())
        except OSError as error:
            fault = _refused(error)
            with self._guard:
                self.missed += entry is not None
                self._gap += entry is not None
                told, self._failing = self._failing, True
            if not told:
                self._report(fault)
            raise fault from None
        return end

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Keep other processes out, and go on from the newest record; raises :class:`OSError`."""
        make_directory(self._folder)
        lock = os.open(self._folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            lock_within(lock, PATIENCE)
            before, size = self._names, -1 if self._file is None else os.fstat(self._file).st_size
            self._names = sorted(filter(_NAME.fullmatch, os.listdir(self._folder)))
            same = self._names[-1:] == before[-1:] and size == (self._size if before else -1)
            if not (same and self._known):
                self._recover()
            yield
        finally:
            os.close(lock)

    def _put_all(self, entry: _Entry | None) -> None:
        if self._damage:
            self._put(_Entry("damage", _now(), {"lost": self._damage}))
            self._damage = ""
        if self._begun and self._after:
            self._put(_Entry("start", _now(), {"after": self._after}))
            self._after = ""
        if surplus := self._names[: -self._kept]:
            self._put(_Entry("dropped", _now(), {"before": int(self._names[-self._kept][:20])}))
            for name in surplus:
                with suppress(OSError):
                    (self._folder / name).unlink()
            self._names = self._names[len(surplus) :]
        if self._gap:
            self._put(_Entry("gap", _now(), {"entries": self._gap}))
            self._gap = 0
        if entry is not None and entry.kind == "refused":
            self._put(entry._replace(facts={**entry.facts, **_told(others=self._untold)}))
            self._untold = 0
        elif entry is not None:
            self._put(entry)
        if self._failing:
            import structlog  # noqa: PLC0415 - late, as in log_fault

            structlog.get_logger().info("the log can be written again", missed=self.missed)
        self._failing = False

    def _put(self, entry: _Entry) -> None:
        """Write one record, whole or not at all."""
        position = self._position + 1
        line = line_of(sign_record(self._signer, position, self._digest, **entry._asdict()))
        data = line + b"\n"
        if self._file is None or self._size + len(data) > self._limit:
            self._begin_file(f"{position:020d}.jsonl", data)
        else:
            try:
                _pwrite(self._file, data, self._size)
            except OSError:
                with suppress(OSError):
                    os.ftruncate(self._file, self._size)
                raise
            self._size += len(data)
        self._refused += len(data) if entry.kind == "refused" else 0
        self._position, self._digest = position, line_digest(line)

    def _begin_file(self, name: str, data: bytes) -> None:
        """Go on in a new file, which takes its name with its first line."""
        if self._file is not None:
            os.fsync(self._file)
        path, new = self._folder / name, self._folder / f"{name}.new"
        file = open_file(new, os.O_RDWR | os.O_CREAT | os.O_TRUNC)
        try:
            _pwrite(file, data, 0)
            new.replace(path)
            sync_folder(self._folder)
        except OSError:
            os.close(file)
            for made in (new, path):
                with suppress(OSError):
                    made.unlink()
            raise
        self._close_file()
        self._file, self._size, self._refused = file, len(data), 0
        self._names = [*self._names, name]

    def _recover(self) -> None:
        """Go on from the newest record that holds, and set aside what comes after it."""
        self._close_file()
        last = None
        while self._names and last is None:
            path = self._folder / self._names[-1]
            content = read_file(path)
            end, last = self._newest(content)
            if end < len(content) or last is None:
                self._set_aside(path, content[end:] if end else None)
            if last is None:
                self._names.pop()
            else:
                self._file, self._size = open_file(path, os.O_RDWR), end
                os.ftruncate(self._file, end)
                lines = content[:end].split(b"\n")
                self._refused = sum(len(each) for each in lines if b'"kind":"refused"' in each)
        breaks = 0 if self._known else self._survey()
        if last is not None and last.position >= self._position:
            self._position, self._digest = last.position, line_digest(line_of(last))
        lost = [f"records in {breaks} places"] if breaks else []
        if self._torn:
            what = "all of it" if last is None else "its end"
            lost.insert(0, f"{what}, which is in {self._aside.name}")
        if lost:
            self._damage = " and ".join(lost)
            fault = f"the log goes on, but it is damaged: {self._damage}"
            self._report(ProblemError("state_lost", fault))
        self._known, self._torn = True, False

    def _newest(self, content: bytes) -> tuple[int, LogRecord | None]:
        """Return the end of the last line of this device, and its record."""
        mine = self._signer.public.encode() in content
        end = content.rfind(b"\n") + 1 if mine else 0
        while end:
            begin = content.rfind(b"\n", 0, end - 1) + 1
            record = read_line(content[begin : end - 1])
            if record is not None and record.device == self._signer.public and is_genuine(record):
                return end, record
            end = begin
        return 0, None

    def _survey(self) -> int:
        """Count places where a line does not follow from the one before; find how it ended."""
        breaks, due = 0, None
        self._after = "cut" if self._names and int(self._names[0][:20]) else "nothing"
        for name in self._names:
            for line in read_file(self._folder / name).split(b"\n")[:-1]:
                start = _START.match(line)
                told = None if start is None else (int(start[1]), start[2].decode())
                breaks += told is None or due not in (None, told)
                due = None if told is None else (told[0] + 1, line_digest(line))
                if start is not None and start[3] in (b"start", b"stop"):
                    self._after = "stop" if start[3] == b"stop" else "cut"
        return breaks

    def _set_aside(self, path: Path, end: bytes | None) -> None:
        """Keep a damaged end, or a whole file, in the place of what was kept so before."""
        if not self._torn:
            shutil.rmtree(self._aside, ignore_errors=True)
        make_directory(self._aside)
        if end is None:
            path.replace(self._aside / path.name)
        else:
            (self._aside / path.name).write_bytes(end)
        self._torn = True

    def _close_file(self) -> None:
        if self._file is not None:
            os.close(self._file)
        self._file = None


def _told(**counts: int) -> dict[str, int]:
    return {name: count for name, count in counts.items() if count}


def _now() -> datetime:
    return datetime.now(UTC).replace(microsecond=0)


def _pwrite(file: int, data: bytes, place: int) -> None:
    if os.pwrite(file, data, place) < len(data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _refused(error: OSError) -> StorageError:
    return StorageError(
        f"the log cannot be written ({error.strerror}): check the state directory's disk; it will "
        "say how many entries are missing"
    )
