"""Labelled measurements of a camera, kept in a file that is gone on with after a break."""

from __future__ import annotations

import fcntl
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Literal, Protocol

import numpy as np
from pydantic import ValidationError

from veilcam_client.arguments import of_type, whole
from veilcam_client.errors import ArgumentError, FileError
from veilcam_client.keys.opening import KeySource, opener_of, receiver_key
from veilcam_client.wire.base import Answer
from veilcam_client.wire.captures import Capture, SealedEmbedding
from veilcam_client.wire.measurements import Measured, MeasurementsHeader
from veilcam_client.wire.simulation import HeldScene
from veilcam_client.wire.status import Status

if TYPE_CHECKING:
    from veilcam_client.camera import Camera
    from veilcam_client.keys.receivers import ReceiverKey

PICTURES = (".png", ".jpg", ".jpeg", ".mpo", ".webp", ".bmp", ".tif", ".tiff", ".gif")
_RECEIVER = "pair a receiver with 'veilcam receiver add', and give its private key"


@dataclass(frozen=True, slots=True)
class Shot:
    """Scene before the camera, and its label."""

    label: str
    picture: Path | None = None
    """Its file; None: a person has put something there."""
    name: str | None = None
    """What the picture is called in the file of measurements; it is measured once."""


class SceneHolder(Protocol):
    """A simulated camera, as far as pictures are held up before it."""

    def hold_scene(self, picture: bytes | None) -> HeldScene:
        """Hold a picture up, or take it away."""


Show = Callable[[Shot], AbstractContextManager[int | None]]
"""Shows a picture as long as its context lasts, which gives the number that a simulated camera has
for it, or None."""


def unaided(shot: Shot) -> AbstractContextManager[None]:  # noqa: ARG001 - somebody else has shown it
    """Show nothing: it is there already."""
    return nullcontext()


def held_before(simulation: SceneHolder) -> Show:
    """Return what shows pictures to a simulated camera, ``held_before(camera.simulation)``."""

    @contextmanager
    def show(shot: Shot) -> Iterator[int | None]:
        if shot.picture is None:
            raise ArgumentError("a shot without a picture cannot be held up: use unaided")
        held = simulation.hold_scene(_content(shot.picture))
        try:
            yield held.scene
        finally:
            simulation.hold_scene(None)

    return show


def labelled_pictures(folder: Path, *, per_class: int | None = None) -> tuple[Shot, ...]:
    """Yield the pictures ``folder/LABEL/...``, one of each label after the other.

    So a collection that is broken off has about as many of each.

    Args:
        folder: folder whose subfolders are named as the labels are.
        per_class: greatest number of pictures of each label.

    Raises:
        FileError: there are none.
    """
    of_type("folder", folder, Path, "a pathlib.Path")
    if per_class is not None:
        whole("per_class", per_class, 1)
    classes = sorted(each for each in _inside(folder) if each.is_dir() and each.name[0] != ".")
    queues = deque(
        deque(
            Shot(each.name, picture, str(picture.relative_to(folder)))
            for picture in sorted(each.rglob("*"))
            if picture.suffix.lower() in PICTURES and picture.is_file()
        )
        for each in classes
    )
    shots: list[Shot] = []
    rounds = 0
    while queues and (per_class is None or rounds < per_class):
        queues = deque(queue for queue in queues if queue)
        shots += [queue.popleft() for queue in queues]
        rounds += 1
    if not shots:
        raise FileError(f"{folder} holds no pictures: put them into {folder}/LABEL/*.png")
    return tuple(shots)


def collect(
    camera: Camera,
    path: Path,
    shots: Iterable[Shot],
    *,
    show: Show = unaided,
    key: KeySource | None = None,
    device: str | None = None,
    advance: Callable[[Shot], None] = lambda _: None,
) -> int:
    """Measure what is shown, and write each measurement to a file as soon as it is taken.

    A file that is there is gone on with: pictures that stand in it are not shown again, and a last
    line that was cut off is taken again. The file is readable by its owner alone: its measurements
    are no longer sealed.

    Args:
        camera: without a ``key`` of its own; it needs the scopes ``read:status`` and
            ``read:embedding``, with ``raw`` embeddings ``read:embedding:raw`` as well.
        path: path of the file.
        shots: shots to measure, in this order.
        show: shows each while it is measured.
        key: private key of a receiver, or its file, where embeddings leave sealed.
        device: public key that the camera must have; None: that of its status.
        advance: called after each.

    Returns:
        How many measurements were added.

    Raises:
        FileError: the file cannot be written or is of another camera or bundle, the camera
            lets out nothing that a classifier reads, or a label is none of its bundle's.
        FileError: the key's file cannot be used.
        SealedError: an embedding cannot be opened.
        VeilcamError: as :meth:`Camera.capture`; what was written before stays.
    """
    of_type("path", path, Path, "a pathlib.Path")
    private = None if key is None else receiver_key(key)
    taker = _Taker(camera, camera.status(), private, device)
    added = 0
    with _locked(path) as stream:
        done = _resumed(stream, path, taker.header)
        for shot in shots:
            if shot.label not in taker.header.labels:
                raise FileError(
                    f"{shot.label!r} is no label of the camera's bundle: use one of "
                    f"{', '.join(taker.header.labels)}"
                )
            if shot.name is not None and shot.name in done:
                continue
            with show(shot) as scene:
                measured = taker.take(shot, scene)
            _write(stream, path, measured)
            done.add(shot.name)
            added += 1
            advance(shot)
    return added


class _Taker:
    """Takes measurements, and opens what comes sealed."""

    def __init__(
        self, camera: Camera, status: Status, key: ReceiverKey | None, device: str | None
    ) -> None:
        self.header = _header(status, key)
        self._camera, self._key = camera, key
        self._device = device or status.device.key
        self._opener = opener_of(key, self._device) if key is not None else None
        self._epoch: str | None = None

    def take(self, shot: Shot, scene: int | None) -> Measured:
        taken = self._camera.capture()
        sealed, mask_key = taken.embedding, None
        if isinstance(sealed, SealedEmbedding):
            taken, mask_key = self._opened(taken, sealed)
        elif taken.epoch != self._epoch:  # what is sealed names its bundle
            self._check_bundle(self._camera.status().bundle.digest)
        self._epoch, embedding = taken.epoch, taken.embedding
        if embedding.form != "raw" or embedding.shape != self.header.shape:
            raise FileError(
                f"an embedding came {embedding.form}, {embedding.shape}, where one as it was read, "
                f"{self.header.shape}, was expected: the camera was changed, collect anew"
            )
        seen = None if taken.notes is None else taken.notes.scene
        if scene is not None and seen is not None and seen != scene:
            raise FileError("another caller held up another scene meanwhile: be alone, and go on")
        return Measured(
            picture=shot.name,
            label=shot.label,
            epoch=taken.epoch,
            number=taken.number,
            taken_at=taken.taken_at,
            values=np.asarray(taken).ravel(),
            mask_key=mask_key,
        )

    def _opened(self, taken: Capture, sealed: SealedEmbedding) -> tuple[Capture, str | None]:
        """Return a capture with its embedding as it was read, and the key of its mask."""
        from veilcam_client.keys.envelopes import open_key  # noqa: PLC0415 - late, as in camera

        if self._key is None or self._opener is None:
            raise FileError(f"embeddings leave sealed: {_RECEIVER}")
        opened = self._opener.open(taken)
        self._check_bundle(sealed.envelope.bundle)
        if self.header.mode == "pairs":
            return opened, None
        epoch = open_key(sealed.envelope, self._key, device=self._device)
        try:
            return opened, epoch.levels().hex()
        finally:
            epoch.erase()

    def _check_bundle(self, digest: str) -> None:
        if digest != self.header.bundle:
            raise FileError("the camera has another bundle now: collect into another file")


def _header(status: Status, key: ReceiverKey | None) -> MeasurementsHeader:
    """Return the first line of this camera's file, if a classifier can be adapted with it."""
    fresh = status.bundle.mode == "fresh"
    for wrong, why in (
        (status.state == "replay", "this daemon replays a recording: collect from a camera"),
        (
            status.release == "none",
            f"no embeddings leave this camera: {_RECEIVER}",
        ),
        (status.release == "sealed" and key is None, f"embeddings leave sealed: {_RECEIVER}"),
        (
            status.release == "raw" and fresh,
            f"a raw embedding does not say which fresh mask it was read behind: {_RECEIVER}",
        ),
    ):
        if wrong:
            raise FileError(why)
    mode: Literal["pairs", "fresh"] = "fresh" if fresh else "pairs"
    return MeasurementsHeader(
        device=status.device.key,
        bundle=status.bundle.digest,
        mode=mode,
        labels=status.bundle.labels,
        shape=status.bundle.embedding_shape,
        begun_at=datetime.now(UTC),
    )


def _content(picture: Path) -> bytes:
    try:
        return picture.read_bytes()
    except OSError as error:
        raise FileError(f"{picture} cannot be read ({error.strerror})") from None


def _inside(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError as error:
        raise FileError(f"{folder} cannot be read ({error.strerror})") from None


@contextmanager
def _locked(path: Path) -> Iterator[BinaryIO]:
    """Open the file so that nobody else adds to it meanwhile."""
    try:
        stream = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT, 0o600), "r+b")
    except OSError as error:
        raise FileError(f"{path} cannot be written ({error.strerror})") from None
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise FileError(f"{path} is being written by another collection") from None
        yield stream


def _resumed(stream: BinaryIO, path: Path, header: MeasurementsHeader) -> set[str | None]:
    """Names of the pictures that stand in a file, which ends with a whole line afterwards."""
    lines = stream.read().split(b"\n")
    whole = lines[:-1]
    if not whole:
        stream.seek(0)
        stream.truncate()
        _write(stream, path, header)
        return set()
    try:
        found = MeasurementsHeader.model_validate_json(whole[0])
    except ValidationError:
        raise FileError(f"{path} is no file of measurements: give another name") from None
    if found.model_copy(update={"begun_at": header.begun_at}) != header:
        raise FileError(
            f"{path} was measured by another camera, or with another bundle: give another name"
        )
    stream.seek(-len(lines[-1]), os.SEEK_END)
    stream.truncate()
    return {_measured(path, number, line).picture for number, line in enumerate(whole[1:], 2)}


def _measured(path: Path, number: int, line: bytes) -> Measured:
    try:
        return Measured.model_validate_json(line)
    except ValidationError:
        raise FileError(f"{path}, line {number}: this is no measurement: remove it") from None


def _write(stream: BinaryIO, path: Path, line: Answer) -> None:
    """Not gone with the machine either: what was measured is not measured again."""
    try:
        stream.write(line.model_dump_json().encode() + b"\n")
        stream.flush()
        os.fsync(stream.fileno())
    except OSError as error:
        raise FileError(f"{path} cannot be written ({error.strerror})") from None
