"""Capture logs in files: fetched from a camera, and checked without it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from veilcam_client.arguments import of_type
from veilcam_client.errors import FileError
from veilcam_client.wire.captures import Capture, Classification
from veilcam_client.wire.log import RECORDS_AT_ONCE, LogHead, LogRecord, LogRecords

if TYPE_CHECKING:
    from veilcam_client.keys.log_check import Examination

_ANSWER: TypeAdapter[Capture | Classification] = TypeAdapter(
    Classification | Capture, config=ConfigDict(defer_build=True)
)
ModelT = TypeVar("ModelT", bound=BaseModel)


class LogSource(Protocol):
    """Log of a camera, as far as it is fetched: ``camera.log``."""

    def list(self, *, limit: int = RECORDS_AT_ONCE, after: int | None = None) -> LogRecords:
        """Return records, the oldest first."""

    def head(self) -> LogHead:
        """End of the log."""


def fetch_log(log: LogSource, path: Path) -> tuple[int, LogHead]:
    """Fetch the log of a camera, or what is new since a file was written.

    Args:
        log: log of a camera, ``camera.log``; it needs the scope ``read:log``.
        path: a new file, or one that this wrote, which is gone on with.

    Returns:
        How many records were added, and the head of the log after that.

    Raises:
        FileError: the file cannot be read or written, or the log does not go on where it ends.
        VeilcamError: as ``camera.log.list()``; what was written before is a whole file.
    """
    of_type("path", path, Path, "a pathlib.Path")
    # Late: no other command of the SDK needs the cryptography.
    from veilcam_client.keys.capture_log import line_digest, line_of  # noqa: PLC0415

    last = _last_of(path)
    follows = None if last is None else line_digest(line_of(last))
    after, added = None if last is None else last.position, 0
    more = True
    while more:
        page = log.list(after=after)
        if page.records:
            if last is not None and not added and page.records[0].previous != follows:
                raise _departed(path)
            _append(path, b"".join(line_of(record) + b"\n" for record in page.records))
            added, after = added + len(page.records), page.records[-1].position
        more = page.next is not None
    head = log.head()
    if last is not None and (
        head.position < last.position or (head.position == last.position and head.record != follows)
    ):
        raise _departed(path)
    return added, head


def verify_log(
    path: Path,
    *,
    device: str | None = None,
    head: Path | None = None,
    answer: Path | None = None,
) -> Examination:
    """Check a file that :func:`fetch_log` wrote.

    Args:
        path: path of the log.
        device: public key that has to have signed it, 64 hexadecimal digits; that of the first
            record if None.
        head: file of a signed head, as JSON.
        answer: file of an answer, as JSON, that must be in the log.

    Returns:
        What was found.

    Raises:
        FileError: a file cannot be read, or holds something else.
    """
    from veilcam_client.keys.log_check import examine  # noqa: PLC0415 - late, as above

    for name, file in (("path", path), ("head", head), ("answer", answer)):
        if file is not None or name == "path":
            of_type(name, file, Path, "a pathlib.Path")
    try:
        return examine(
            _content(path),
            device=device,
            head=None if head is None else LogHead.model_validate_json(_content(head)),
            answer=None if answer is None else _ANSWER.validate_json(_content(answer)),
        )
    except ValidationError as error:
        which = head if error.title == LogHead.__name__ else answer
        raise FileError(f"{which} holds something else: give the answer as JSON") from None
    except ValueError as error:
        raise FileError(f"{answer}: {error}") from None


def _last_of(path: Path) -> LogRecord | None:
    """Return the last record of a file; None: there is no file, or nothing in it."""
    from veilcam_client.keys.capture_log import read_line  # noqa: PLC0415 - late, as above

    content = _content(path) if path.exists() else b""
    if not content:
        return None
    *_, last, rest = (b"", *content.split(b"\n"))
    try:
        return read_line(last if not rest else b"")
    except ValueError:
        raise FileError(
            f"{path} does not end with a record: verify it, or give another file"
        ) from None


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileError(f"{path} cannot be read ({error.strerror}): check it") from None


def _append(path: Path, lines: bytes) -> None:
    try:
        with path.open("ab") as stream:
            stream.write(lines)
    except OSError as error:
        raise FileError(f"{path} cannot be written ({error.strerror}): check it") from None


def _departed(path: Path) -> FileError:
    return FileError(
        f"the camera's log does not go on where {path} ends: records in between were dropped, or "
        "it began anew; keep that file, and give another one"
    )
