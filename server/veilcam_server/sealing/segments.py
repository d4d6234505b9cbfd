"""Segments of the capture log: files of lines, of which the oldest make room for new ones."""

from __future__ import annotations

import errno
import os
import re
import shutil
from bisect import bisect_right
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from veilcam_client.keys.capture_log import line_digest
from veilcam_optics.files import sync_folder
from veilcam_server.system.state_file import make_directory
from veilcam_server.system.state_folder import open_file, read_file

SEGMENT_BYTES = 4 << 20
"""Size of one file."""
SEGMENTS_KEPT = 16
"""Files that stay: 64 MiB, some 100,000 captures."""
_NAME = re.compile(r"^(\d{20})\.jsonl$")
_START = re.compile(
    rb'^\{"version":1,"device":"[0-9a-f]{64}","position":(\d+),"previous":"([0-9a-f]{64})",'
)
"""Of every line."""

Genuine = Callable[[bytes], bool]
"""Whether a line is a record of this device."""


@dataclass(frozen=True, slots=True)
class Ending:
    """End of a log that is continued."""

    last: bytes | None
    """The newest line that holds; None: there is none."""
    torn: bool
    """Whether something came after that line, or instead of it, that does not hold."""
    breaks: int
    """Places before it where a line does not follow from the one before."""


class Segments:
    """Lines in files, each named by the position of its first. One thread at a time writes.

    A line is one write: it is there whole once :meth:`append` returns, also if the process is then
    killed. What a cut of the power takes is what came since the last :meth:`flush`.

    Args:
        folder: folder of the files; made as soon as there is a line.
        limit: size of one file [bytes].
        kept: number of files that stay.
    """

    def __init__(
        self, folder: Path, *, limit: int = SEGMENT_BYTES, kept: int = SEGMENTS_KEPT
    ) -> None:
        self._folder, self._limit, self._kept = folder, limit, kept
        self._firsts: list[int] = []
        self._file: int | None = None
        self._size = 0

    @property
    def aside(self) -> Path:
        """Folder of what did not hold when the log was last gone on with."""
        return self._folder.with_name(f"{self._folder.name}.damaged")

    @property
    def oldest(self) -> int:
        """Position that the oldest file begins at; 0 if there is none."""
        return self._firsts[0] if self._firsts else 0

    @property
    def surplus(self) -> int:
        """Position before which all is to be dropped; 0: nothing is."""
        return self._firsts[-self._kept] if len(self._firsts) > self._kept else 0

    def recover(self, genuine: Genuine) -> Ending:
        """Find the newest line that holds, and set aside what comes after it.

        Raises:
            OSError: the disk refuses, or a file cannot be read; call it again.
        """
        self.close()
        found = sorted(
            int(name[1]) for path in self._entries() if (name := _NAME.match(path.name)) is not None
        )
        self._firsts, torn = found.copy(), False
        while self._firsts:
            content = _read(self._path(self._firsts[-1]))
            kept = _end_of_last(content, genuine)
            if kept < len(content) or not kept:
                self._set_aside(content[kept:] if kept else None, first=not torn)
                torn = True
            if kept:
                self._file, self._size = open_file(self._path(self._firsts[-1]), os.O_RDWR), kept
                os.ftruncate(self._file, kept)
                last = content[:kept].splitlines()[-1]
                return Ending(last, torn, self._breaks())
            self._firsts.pop()
        return Ending(None, torn, 0)

    def append(self, position: int, line: bytes) -> None:
        """Write one line, whole or not at all; raises :class:`OSError`."""
        data = line + b"\n"
        removed = self._file is not None and os.fstat(self._file).st_nlink == 0
        if self._file is None or removed or self._size + len(data) > self._limit:
            self._begin(position, data)
            return
        try:
            _write(self._file, data, self._size)
        except OSError:
            with suppress(OSError):  # half a line: the next one is written over it
                os.ftruncate(self._file, self._size)
            raise
        self._size += len(data)

    def drop(self) -> None:
        """Remove what is too much; what cannot be removed stays."""
        while len(self._firsts) > self._kept:
            with suppress(OSError):
                self._path(self._firsts[0]).unlink()
            del self._firsts[0]

    def flushable(self) -> int | None:
        """Return a descriptor to flush what was written so far; the caller closes it.

        None: nothing was written.
        """
        return None if self._file is None else os.dup(self._file)

    def files(self, position: int) -> list[tuple[Path, int | None]]:
        """Files with the lines from a position on, and how much of each counts; None: all."""
        begin = max(0, bisect_right(self._firsts, position) - 1)
        firsts = self._firsts[begin:]
        sizes = [None] * (len(firsts) - 1) + [self._size]
        return [(self._path(first), size) for first, size in zip(firsts, sizes, strict=False)]

    def close(self) -> None:
        """Close the file; twice does no harm."""
        if self._file is not None:
            os.close(self._file)
        self._file = None

    def _entries(self) -> list[Path]:
        return list(self._folder.iterdir()) if self._folder.is_dir() else []

    def _path(self, first: int) -> Path:
        return self._folder / f"{first:020d}.jsonl"

    def _begin(self, position: int, data: bytes) -> None:
        """Go on in a new file; the one before is on the disk then.

        It takes its name with its first line: one that is empty has lost something.
        """
        if self._file is not None:
            os.fsync(self._file)
        make_directory(self._folder)
        path = self._path(position)
        new = path.with_suffix(".new")
        file = open_file(new, os.O_RDWR | os.O_CREAT | os.O_TRUNC)
        try:
            _write(file, data, 0)
            new.replace(path)
            sync_folder(self._folder)
        except OSError:
            os.close(file)
            for made in (new, path):
                with suppress(OSError):
                    made.unlink()
            raise
        self.close()
        self._file, self._size = file, len(data)
        self._firsts = [*(first for first in self._firsts if first != position), position]

    def _set_aside(self, end: bytes | None, *, first: bool) -> None:
        """Keep the end of the newest file, or all of the file, in the place of what was kept so."""
        if first:
            shutil.rmtree(self.aside, ignore_errors=True)
        make_directory(self.aside)
        path = self._path(self._firsts[-1])
        if end is None:
            path.replace(self.aside / path.name)
        else:
            (self.aside / path.name).write_bytes(end)

    def _breaks(self) -> int:
        """Count places where a line does not follow from the one before."""
        breaks, due = 0, (b"", b"")
        for first in self._firsts:
            for line in lines_of(_read(self._path(first))):
                start = _START.match(line)
                told = (b"", b"") if start is None else (start[1], start[2])
                breaks += start is None or due not in ((b"", b""), told)
                due = _after(told[0], line) if start is not None else (b"", b"")
        return breaks


def lines_of(content: bytes) -> Iterator[bytes]:
    """Whole lines, without their ends."""
    return iter(content.split(b"\n")[:-1])


def position_of(line: bytes) -> int | None:
    """Position that a line says it has; None: it is none of a log."""
    start = _START.match(line)
    return None if start is None else int(start[1])


def _write(file: int, data: bytes, place: int) -> None:
    if os.pwrite(file, data, place) < len(data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _read(path: Path) -> bytes:
    """Return what a file holds, nothing where it is gone; raises :class:`OSError`."""
    try:
        return read_file(path)
    except FileNotFoundError:
        return b""


def _after(position: bytes, line: bytes) -> tuple[bytes, bytes]:
    """Position and previous digest of the line that follows."""
    return str(int(position) + 1).encode(), line_digest(line).encode()


def _end_of_last(content: bytes, genuine: Genuine) -> int:
    """Return the end of the last valid line; 0: there is none."""
    end = content.rfind(b"\n") + 1
    while end:
        begin = content.rfind(b"\n", 0, end - 1) + 1
        if genuine(content[begin : end - 1]):
            return end
        end = begin
    return 0
