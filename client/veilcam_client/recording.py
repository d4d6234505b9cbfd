"""Recordings: what a camera answered, in a file, for ``veilcamd serve --replay``.

JSON lines. The first tells which camera it was, every other one is a capture as the SDK gave it,
with its label where it was asked for. What came sealed stays sealed, unless the camera had a key:
then it is raw, and whoever may read the file may read it.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Literal

from pydantic import ValidationError

from veilcam_client.arguments import of_type, whole
from veilcam_client.errors import FileError
from veilcam_client.wire.base import Answer
from veilcam_client.wire.captures import Capture, Prediction
from veilcam_client.wire.status import Status

if TYPE_CHECKING:
    from veilcam_client.camera import Camera

MAX_BYTES = 2**28
"""Of a recording: some 16,000 captures of 24 x 32 [bytes]."""


class Header(Answer):
    """The first line."""

    format: Literal["veilcam-recording"] = "veilcam-recording"
    version: Literal[1] = 1
    recorded_at: datetime
    status: Status
    """Of the camera when the recording began; its ``release`` is the form in this file."""


class Recorded(Answer):
    """One capture; every other line is one."""

    capture: Capture
    verdict: Prediction | None = None
    """With scores where the token had a scope for them."""


@dataclass(frozen=True, slots=True)
class Recording:
    """Contents of a recording."""

    header: Header
    captures: tuple[Recorded, ...]


def record(
    camera: Camera,
    path: Path,
    *,
    count: int,
    labels: bool = False,
    advance: Callable[[], None] = lambda: None,
) -> int:
    """Take captures and write them to a new file, each as soon as it is taken.

    Args:
        camera: needs the scopes ``read:status``, ``read:embedding``, with ``raw`` embeddings
            ``read:embedding:raw``, and with labels ``classify``.
        path: readable by its owner alone.
        count: number of captures.
        labels: have each classified as well.
        advance: called after each.

    Returns:
        Bytes that were written.

    Raises:
        FileError: the file exists or cannot be written, or the camera itself is a recording.
        VeilcamError: as :meth:`Camera.capture`; what was written before is a whole recording.
    """
    of_type("path", path, Path, "a pathlib.Path")
    whole("count", count, 1)
    status = camera.status()
    if status.state == "replay":
        raise FileError("this daemon replays a recording: copy its file")
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb") as stream:
            for place in range(count):
                taken = _take(camera, labels=labels)
                if place == 0:
                    # Only now is it known: a camera that has a key opens what is released sealed.
                    form = taken.capture.embedding.form
                    status = status.model_copy(update={"release": form})
                    _write(stream, Header(recorded_at=datetime.now(UTC), status=status))
                _write(stream, taken)
                advance()
            return stream.tell()
    except FileExistsError:
        raise FileError(f"{path} exists: give another name") from None
    except OSError as error:
        raise FileError(f"{path} cannot be written ({error.strerror})") from None


def read_recording(path: Path) -> Recording:
    """Read a file that :func:`record` wrote, and check all of it.

    Raises:
        FileError: it is missing, damaged, or no such file.
    """
    of_type("path", path, Path, "a pathlib.Path")
    try:
        size = path.stat().st_size
        content = path.read_bytes() if size <= MAX_BYTES else b""
    except OSError as error:
        raise FileError(f"{path} cannot be read ({error.strerror})") from None
    if size > MAX_BYTES:
        raise FileError(f"{path} is larger than {MAX_BYTES >> 20} MiB: replay a part of it")
    first, *lines = content.split(b"\n")
    try:
        header = Header.model_validate_json(first)
    except ValidationError:
        raise FileError(
            f"{path} is no recording of this version: make one with 'veilcam record'"
        ) from None
    if not lines or lines.pop() != b"":
        raise FileError(f"{path} is cut off: remove its last line")
    if not lines:
        raise FileError(f"{path} holds no captures: make it again with 'veilcam record'")
    captures = tuple(_recorded(header, path, number, line) for number, line in enumerate(lines, 2))
    return Recording(header, captures)


def _take(camera: Camera, *, labels: bool) -> Recorded:
    if not labels:
        return Recorded(capture=camera.capture())
    answer = camera.classify(include_embedding=True)
    if answer.embedding is None:
        raise FileError("the daemon left the embedding out: update it")
    return Recorded(
        capture=Capture(
            id=answer.id,
            epoch=answer.epoch,
            number=answer.number,
            taken_at=answer.taken_at,
            embedding=answer.embedding,
            replay=answer.replay,
            notes=answer.notes,
        ),
        verdict=Prediction(label=answer.label, confidence=answer.confidence, scores=answer.scores),
    )


def _recorded(header: Header, path: Path, number: int, line: bytes) -> Recorded:
    """One line, which has to be of the camera that the header names."""
    try:
        recorded = Recorded.model_validate_json(line)
    except ValidationError:
        raise FileError(f"{path}, line {number}: this is no capture: remove it") from None
    capture, bundle = recorded.capture, header.status.bundle
    form, release, verdict = capture.embedding.form, header.status.release, recorded.verdict
    for wrong, fault in (
        (capture.replay is not None, "was itself replayed: record a camera"),
        (
            capture.embedding.shape != bundle.embedding_shape,
            "is of another camera: remove it",
        ),
        (form != release, f"is {form}, and the others are {release}: remove it"),
        (
            verdict is not None and verdict.label not in bundle.labels,
            "label is not one of the camera's: remove it",
        ),
    ):
        if wrong:
            raise FileError(f"{path}, line {number}: this {fault}")
    return recorded


def _write(stream: BinaryIO, line: Answer) -> None:
    stream.write(line.model_dump_json().encode() + b"\n")
    stream.flush()
