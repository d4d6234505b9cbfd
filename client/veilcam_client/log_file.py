"""Logs in files, fetched from a camera."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from veilcam_client.arguments import of_type
from veilcam_client.errors import FileError
from veilcam_client.wire.log import RECORDS_AT_ONCE, LogRecords


class LogSource(Protocol):
    """Log of a camera, as far as it is fetched: ``camera.log``."""

    def list(self, *, limit: int = RECORDS_AT_ONCE, after: int | None = None) -> LogRecords:
        """Return records, the oldest first."""


def fetch_log(log: LogSource, path: Path) -> int:
    """Fetch the log of a camera, or what is new since a file was written.

    Args:
        log: log of a camera, ``camera.log``; it needs the scope ``read:log``.
        path: a new file, or one that this wrote, which is gone on with.

    Returns:
        Number of records that were added.

    Raises:
        FileError: the file cannot be read or written, or the log does not go on where it ends.
        VeilcamError: as ``camera.log.list()``; what was written before is a whole file.
    """
    of_type("path", path, Path, "a pathlib.Path")
    # Late: no other command of the SDK needs the cryptography.
    from veilcam_client.keys.log import line_of, read_line  # noqa: PLC0415

    added, more = 0, True
    try:
        with path.open("a+b") as stream:
            stream.seek(0)
            content = stream.read()
            last = content[:-1].rpartition(b"\n")[2]
            known = read_line(last) if content.endswith(b"\n") else None
            if content and known is None:
                raise FileError(
                    f"{path} does not end with a record: verify it, or give another file"
                )
            # The last record is asked for again: the log has to go on with what follows from it.
            after = known.position - 1 if known is not None and known.position else None
            while more:
                page = log.list(after=after)
                lines = [line_of(record) for record in page.records]
                if known is not None and lines[:1] != [last]:
                    raise FileError(
                        f"the camera's log does not go on where {path} ends: records in between "
                        "were dropped, or it began anew; keep that file, and give another one"
                    )
                lines, known = lines[known is not None :], None
                stream.write(b"".join(line + b"\n" for line in lines))
                stream.flush()
                added, after, more = added + len(lines), page.next, page.next is not None
    except OSError as error:
        raise FileError(f"{path} cannot be read and written ({error.strerror}): check it") from None
    return added
