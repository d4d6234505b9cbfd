"""Audit log: who did what, with which outcome, as JSON lines in the state directory."""

from __future__ import annotations

import errno
import json
import os
import threading
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from veilcam_optics.files import sync_folder
from veilcam_server.errors import StorageError
from veilcam_server.system.state_file import Report, log_fault, make_directory
from veilcam_server.system.state_folder import open_file, read_file, unreadable

DONE, REFUSED = "audit.jsonl", "refused.jsonl"
"""What callers did, and what was asked without a valid token. Apart, so that a stranger who knocks
ten thousand times does not push out what happened inside."""


class AuditLog:
    """One file of JSON lines and the full ones before it, ``NAME.1`` the latest of them.

    A disk that is full stops no capture: what could not be written is counted, and reported once.
    A change is another thing: it is made where its line is on the disk before it is acknowledged.

    Args:
        path: path of the file; made, for its owner alone, as soon as it can be.
        limit: size of one file [bytes].
        kept: number of full files that stay.
        report: takes that it cannot be written.
    """

    def __init__(
        self, path: Path, limit: int = 8 << 20, kept: int = 7, report: Report = log_fault
    ) -> None:
        self._path, self._limit, self._kept, self._report = path, limit, kept, report
        self.lost = 0
        """Lines that could not be written."""
        self._failing = False
        self._lock = threading.Lock()
        self._file: int | None = None
        self._size = 0
        self._torn = False

    def write(self, action: str, *, durable: bool = False, **details: str | int | None) -> None:
        """Append one line: now, the action, and those details that are not None.

        Args:
            action: action that was done or refused.
            durable: the line is flushed to the disk, or this raises.
            details: further facts.

        Raises:
            StorageError: a line that must be durable is not.
        """
        entry: dict[str, Any] = {
            "at": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "action": action,
            **{name: value for name, value in details.items() if value is not None},
        }
        try:
            self._append(json.dumps(entry, ensure_ascii=True).encode() + b"\n", flush=durable)
        except OSError as error:
            self.lost += 1
            fault = StorageError(
                f"the audit log cannot be written ({error.strerror}): check the state directory's "
                "disk"
            )
            if not self._failing:
                self._report(fault)
            self._failing = True
            if durable:
                raise fault from None
            return
        if self._failing:
            import structlog  # noqa: PLC0415 - as in log_fault

            structlog.get_logger().info("audit log can be written again", lost=self.lost)
        self._failing = False

    def require(self) -> None:
        """Raise :class:`StorageError` while it cannot be written, before anything is changed."""
        if self._failing:
            self.write("audit log was out of reach", durable=True, lost=self.lost)

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            os.close(self._file)
        self._file = None

    def _append(self, line: bytes, *, flush: bool) -> None:
        with self._lock:
            file = self._opened()
            if self._size + len(line) > self._limit:
                self.close()
                self._number()
                file = self._opened()
            # Half a line, of a cut or a full disk, must not spoil the next one.
            line = b"\n" + line if self._torn else line
            # One write to a file opened for appending: lines of two processes do not mix.
            written = os.write(file, line)
            self._size += written
            self._torn = written < len(line)
            if self._torn:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            flushed = os.dup(file) if flush else None
        # Nobody waits for the disk who need not: another thread may go on with the file.
        if flushed is not None:
            with os.fdopen(flushed) as held:
                os.fsync(held.fileno())

    def _opened(self) -> int:
        if self._file is not None and os.fstat(self._file).st_nlink == 0:
            self.close()  # somebody removed it
        if self._file is None:
            make_directory(self._path.parent)
            self._file = open_file(self._path, os.O_RDWR | os.O_APPEND | os.O_CREAT)
            self._size = os.fstat(self._file).st_size
            self._torn = self._size > 0 and os.pread(self._file, 1, self._size - 1) != b"\n"
            if self._size == 0:
                sync_folder(self._path.parent)
        return self._file

    def _number(self) -> None:
        for number in range(self._kept, 0, -1):
            older = _numbered(self._path, number - 1)
            if older.exists():
                older.replace(_numbered(self._path, number))


def read_audit(path: Path) -> list[dict[str, Any]]:
    """Return what the file and the full ones before it say, the oldest first.

    A line that is damaged is an entry that says so.

    Raises:
        StartError: one of them cannot be read.
    """
    number = 0
    entries = []
    try:
        while _numbered(path, number + 1).exists():
            number += 1
        for each in range(number, -1, -1):
            file = _numbered(path, each)
            lines = read_file(file).split(b"\n") if file.exists() else []
            entries += [_entry(line, file.name) for line in lines if line]
    except OSError as error:
        raise unreadable(error, path.parent) from None
    return entries


def _entry(line: bytes, name: str) -> dict[str, Any]:
    try:
        found = json.loads(line)
    except ValueError:
        found = None
    if isinstance(found, dict) and {"at", "action"} <= found.keys():
        return found
    return {"at": "", "action": "a line that is damaged", "file": name}


def _numbered(path: Path, number: int) -> Path:
    return path.with_name(f"{path.name}.{number}") if number else path
