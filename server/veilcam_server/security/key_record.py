"""Idempotency keys of the last minute on the disk, so that a restart does nothing twice.

Two files of lines take turns, ``idempotency-0`` and ``idempotency-1``. A line holds the time,
hashes of the key and of its request, and a checksum; no key, no request and no answer is in it. A
line that was not written to its end is as if it were not there.
"""

from __future__ import annotations

import errno
import os
import re
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import structlog

from veilcam_optics.files import sync_folder
from veilcam_server.system.state_folder import open_file, read_file, unreadable

LIFETIME = 60.0
"""How long a key is remembered [s]."""
_LINE = re.compile(rb"(\d{1,12}) ([0-9a-f]{64}) ([0-9a-f]{64}) ([0-9a-f]{8})")

log = structlog.get_logger()


class KeyRecord:
    """Record of the work done under each key.

    Args:
        directory: state directory; it exists.
        now: seconds since 1970.
        elapsed: a clock that is never set [s].
    """

    def __init__(
        self,
        directory: Path,
        now: Callable[[], float] = time.time,
        elapsed: Callable[[], float] = time.monotonic,
    ) -> None:
        self._paths = [directory / f"idempotency-{number}" for number in (0, 1)]
        self._now, self._elapsed = now, elapsed
        self._lock = threading.Lock()
        self._present = 0
        self._begun: float | None = None
        """When the first line of the present file was written; None: it is full."""

    def read(self) -> dict[bytes, bytes]:
        """Fingerprints by name, of the last minute. A clock that was set back forgets none.

        Raises:
            StartError: they cannot be read.
        """
        since = self._now() - LIFETIME
        lines = [list(_lines(path)) for path in self._paths]
        begun = [min((at for at, _, _ in each), default=0.0) for each in lines]
        self._present = 0 if begun[0] >= begun[1] else 1
        self._begun = self._elapsed() if begun[self._present] > since else None
        return {name: fingerprint for each in lines for at, name, fingerprint in each if at > since}

    def add(self, name: bytes, fingerprint: bytes) -> None:
        """Write down a key, and return once it is on the disk.

        Args:
            name: hash of caller and key, 32 bytes.
            fingerprint: digest of the request, 32 bytes.

        Raises:
            OSError: the disk refuses.
        """
        content = f"{self._now():.0f} {name.hex()} {fingerprint.hex()}".encode()
        # Begun on a line of its own: what was before may be half a line.
        line = b"\n%s %08x\n" % (content, zlib.crc32(content))
        with self._lock:
            elapsed = self._elapsed()
            if self._begun is None or elapsed - self._begun > LIFETIME:
                # All of the other file is older than the first line of this one.
                self._present, self._begun = 1 - self._present, elapsed
                self._paths[self._present].unlink(missing_ok=True)
            _append(self._paths[self._present], line)


def _append(path: Path, line: bytes) -> None:
    new = not path.exists()
    descriptor = open_file(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    try:
        if os.write(descriptor, line) < len(line):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.fdatasync(descriptor)
    finally:
        os.close(descriptor)
    if new:
        sync_folder(path.parent)


def _lines(path: Path) -> Iterator[tuple[float, bytes, bytes]]:
    try:
        content = read_file(path)
    except FileNotFoundError:
        return
    except OSError as error:
        raise unreadable(error, path.parent) from None
    damaged = 0
    for line in filter(None, content.split(b"\n")):
        found = _LINE.fullmatch(line)
        if found is None or int(found[4], 16) != zlib.crc32(line[:-9]):
            damaged += 1
        else:
            yield (
                float(found[1]),
                bytes.fromhex(found[2].decode()),
                bytes.fromhex(found[3].decode()),
            )
    if damaged:
        log.warning("idempotency keys were damaged", file=path.name, lines=damaged)
