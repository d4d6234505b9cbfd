"""Bundles on the disk: installed bundles, and which of them is in use.

``DIRECTORY/DIGEST.veilcam`` holds a bundle, readable by its owner alone; ``DIRECTORY/in-use.json``
names the one in use, the one used before it, and the bundle that the daemon was started with at the
time. Files are replaced whole, so that whatever is killed or unplugged when, each holds what it
held before or what it holds now; that record is kept twice (:mod:`~veilcam_server.system`).
"""

from __future__ import annotations

import dataclasses
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from pydantic import BaseModel, ConfigDict

from veilcam_optics.files import sync_folder
from veilcam_server.bundles.owners import Used
from veilcam_server.errors import ProblemError, StorageError, UnknownBundleError
from veilcam_server.system.state_file import Report, Staged, StateStore, log_fault, make_directory

CAPACITY = 32
"""Most bundles that can be installed."""
_SUFFIX = ".veilcam"
_TEMPORARY = ".new-"
_DIGEST = re.compile(r"[0-9a-f]{64}")


class _InUse(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")
    active: str
    before: str
    configured: str
    version: int = 0
    """Of the active one."""
    highest: int = 0
    """Version of the newest one in use ever that an owner had signed."""
    newest: str = ""
    """Digest of that."""


class BundleStore:
    """Bundles by the SHA-256 of their file.

    Args:
        directory: made when the first one is installed.
        configured: the bundle that the daemon was started with; it stays where it is.
        digest: SHA-256 of the bundle.
        report: takes what was damaged.
    """

    def __init__(
        self, directory: Path, configured: Path, digest: str, report: Report = log_fault
    ) -> None:
        self._record = StateStore(
            directory / "in-use.json",
            _InUse,
            lost="the bundle that the daemon was started with is in use; activate another one",
            report=report,
        )
        self._directory, self._given = directory, configured
        self.configured = digest
        """Digest of the bundle that the daemon was started with."""
        for left in directory.glob(f"{_TEMPORARY}*"):
            with suppress(OSError):  # it takes up room, and nothing else
                left.unlink()

    def candidates(self) -> tuple[str, ...]:
        """List the bundles to try, the best first; the configured one comes last.

        What was activated holds until the daemon is started with another bundle.
        """
        chosen = self._record.read()
        if chosen is None or chosen.configured != self.configured:
            return (self.configured,)
        return tuple(dict.fromkeys((chosen.active, chosen.before, self.configured)))

    @property
    def lost(self) -> bool:
        """True where the record of the bundle in use was lost."""
        return self._record.lost

    @property
    def goes_on(self) -> bool:
        """Return whether the daemon was last started with the same bundle, or never."""
        chosen = self._record.read()
        return chosen is None or chosen.configured == self.configured

    @property
    def used(self) -> Used:
        """Record of the bundles that were in use."""
        chosen = self._record.read()
        return Used() if chosen is None else Used(chosen.version, chosen.highest, chosen.newest)

    def digests(self) -> tuple[str, ...]:
        """All of them, the configured one first."""
        names = {path.stem for path in self._directory.glob(f"*{_SUFFIX}")}
        installed = (name for name in names - {self.configured} if _DIGEST.fullmatch(name))
        return (self.configured, *sorted(installed))

    def path(self, digest: str) -> Path:
        """Return the path of a bundle; raises :class:`UnknownBundleError`."""
        if digest == self.configured:
            return self._given
        path = self._path(digest)
        if not (_DIGEST.fullmatch(digest) and path.is_file()):
            raise UnknownBundleError("there is no bundle of this digest: see GET /v1/bundles")
        return path

    @contextmanager
    def incoming(self) -> Iterator[tuple[Path, BinaryIO]]:
        """Yield a new file, and its path, that is gone afterwards unless it was installed.

        Raises:
            ProblemError: there are too many already.
            StorageError: the disk refuses.
        """
        self._require_room()
        with _durable():
            descriptor, name = self._temporary()
        try:
            with os.fdopen(descriptor, "wb") as stream:
                yield Path(name), stream
        finally:
            Path(name).unlink(missing_ok=True)

    def install(self, temporary: Path, digest: str) -> None:
        """Move a whole and checked file into its place.

        Raises:
            ProblemError: others came meanwhile, and there are too many now.
            StorageError: the disk refuses.
        """
        if digest == self.configured:
            return
        if not self._path(digest).exists():
            self._require_room()
        with _durable():
            with temporary.open("rb") as stream:
                os.fsync(stream.fileno())
            temporary.replace(self._path(digest))
            sync_folder(self._directory)

    def remove(self, digest: str, active: str) -> None:
        """Remove a bundle for good.

        Raises:
            UnknownBundleError: there is none of this digest.
            ProblemError: it is the active or the configured one.
            StorageError: the disk refuses.
        """
        path = self.path(digest)
        if digest in (active, self.configured):
            raise ProblemError(
                "conflict", "this bundle is in use, or the daemon was started with it: it stays"
            )
        with _durable():
            path.unlink()
            sync_folder(self._directory)

    def stage(self, digest: str, before: str, used: Used) -> Staged[_InUse]:
        """Write down that ``digest`` is in use, for its commit.

        Everything that a full disk can prevent is done here.

        Args:
            digest: digest of the bundle in use.
            before: digest of the one in use before it.
            used: record to keep from now on.

        Raises:
            StorageError: the disk refuses.
        """
        record = _InUse(
            active=digest, before=before, configured=self.configured, **dataclasses.asdict(used)
        )
        with _durable():
            make_directory(self._directory)
        return self._record.stage(lambda _: record)

    def settle(self, digest: str, used: Used) -> None:
        """Write down what the daemon starts with, unless that is known.

        Raises:
            StorageError: the disk refuses.
        """
        chosen = self._record.read()
        same = chosen is not None and chosen.configured == self.configured
        if chosen is not None and same and (chosen.active, self.used) == (digest, used):
            return
        before = chosen.before if chosen is not None and same else digest
        with closing(self.stage(digest, before, used)) as staged:
            staged.commit()

    def _require_room(self) -> None:
        if len(self.digests()) > CAPACITY:
            raise ProblemError("conflict", f"{CAPACITY} bundles are installed: remove one first")

    def _temporary(self) -> tuple[int, str]:
        make_directory(self._directory)
        return tempfile.mkstemp(dir=self._directory, prefix=_TEMPORARY)

    def _path(self, digest: str) -> Path:
        return self._directory / f"{digest}{_SUFFIX}"


def append(stream: BinaryIO, chunk: bytes) -> None:
    """Write to an incoming file; raises :class:`StorageError`."""
    with _durable():
        stream.write(chunk)
        stream.flush()


@contextmanager
def _durable() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise StorageError(
            f"the bundle cannot be stored ({error.strerror}): check the state directory's disk"
        ) from None
