"""Who did what, and what came of it: JSON lines in the state directory."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import structlog

from veilcam_server.errors import StartError

log = structlog.get_logger()

DONE, REFUSED = "audit.jsonl", "refused.jsonl"
"""What callers did, and what was asked without a valid token. Apart, so that a stranger who knocks
ten thousand times does not push out what happened inside."""


class AuditLog:
    """One file of JSON lines and the full ones before it, ``NAME.1`` the latest of them.

    A disk that is full stops no capture: what could not be written is counted, and the log says so
    once.

    Args:
        path: of the file; made, for its owner alone.
        limit: size of one file [bytes].
        kept: how many full ones stay.

    Raises:
        StartError: it cannot be written.
    """

    def __init__(self, path: Path, limit: int = 8 << 20, kept: int = 7) -> None:
        self._path, self._limit, self._kept = path, limit, kept
        self.lost = 0
        self._failing = False
        try:
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            self._open()
        except OSError as error:
            raise StartError(
                f"{path} cannot be written ({error.strerror}): check it, "
                "or give another --state-dir"
            ) from None

    def write(self, action: str, **details: str | int | None) -> None:
        """Append one line: now, the action, and those details that are not None."""
        entry: dict[str, Any] = {
            "at": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "action": action,
            **{name: value for name, value in details.items() if value is not None},
        }
        line = json.dumps(entry, ensure_ascii=True).encode() + b"\n"
        try:
            if self._size + len(line) > self._limit:
                self._rotate()
            # One write to a file opened for appending: lines of two processes do not mix.
            os.write(self._file, line)
            self._size += len(line)
        except OSError as error:
            self.lost += 1
            if not self._failing:
                log.error("audit log cannot be written", error=error.strerror)
            self._failing = True
            return
        if self._failing:
            log.info("audit log can be written again", lost=self.lost)
        self._failing = False

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)

    def _open(self) -> None:
        self._file = os.open(self._path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
        self._size = os.fstat(self._file).st_size

    def _rotate(self) -> None:
        for number in range(self._kept, 0, -1):
            older = _numbered(self._path, number - 1)
            if older.exists():
                older.replace(_numbered(self._path, number))
        os.close(self._file)
        self._open()


def read_audit(path: Path) -> list[dict[str, Any]]:
    """Return what the file and the full ones before it say, the oldest first.

    Raises:
        StartError: one of them cannot be read.
    """
    number = 0
    while _numbered(path, number + 1).exists():
        number += 1
    entries = []
    try:
        for each in range(number, -1, -1):
            file = _numbered(path, each)
            lines = file.read_text().splitlines() if file.exists() else []
            entries += [json.loads(line) for line in lines if line.endswith("}")]
    except (OSError, ValueError) as error:
        raise StartError(f"{path} cannot be read ({error}): check it") from None
    return entries


def _numbered(path: Path, number: int) -> Path:
    return path.with_name(f"{path.name}.{number}") if number else path
