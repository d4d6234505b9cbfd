"""State stores: small records in two copies, each with name, serial and checksum inside.

A record that is damaged is noticed and put right from its copy. That, and every loss of both, is
reported: nothing goes back to an earlier state in silence.
"""

from __future__ import annotations

import errno
import fcntl
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Generic, TypeAlias, TypeVar

from pydantic import BaseModel, ValidationError

from veilcam_optics.files import sync_folder
from veilcam_server.errors import ProblemError, StartError, StorageError
from veilcam_server.system.state_folder import open_file, read_file, require_usable, unusable

StateT = TypeVar("StateT", bound=BaseModel)
Report: TypeAlias = Callable[[ProblemError], None]
"""Takes a fault that ended nothing; neither blocks nor fails."""

MAX_BYTES = 2**24
"""A longer file is no record: a daemon has thousands of tokens at most."""
_PAUSE = 0.01


def log_fault(error: ProblemError) -> None:
    """Write a fault to the log, where nobody else takes it."""
    # Late: it loads what colours a terminal, and a command that only reads its state needs none.
    import structlog  # noqa: PLC0415

    structlog.get_logger().warning("fault", code=error.code, detail=str(error), remedy=error.remedy)


@dataclass(frozen=True, slots=True)
class _Copy(Generic[StateT]):
    """Contents of one file: a state with its serial number, or the reason why there is none."""

    path: Path
    content: bytes = b""
    serial: int = -1
    state: StateT | None = None
    fault: str = ""


@dataclass(frozen=True, slots=True)
class Staged(Generic[StateT]):
    """A change of a record that is on the disk, beside it."""

    state: StateT
    """The record as it will be."""
    commit: Callable[[], None]
    """Makes it hold; raises :class:`StorageError` as :meth:`StateStore.change`."""
    close: Callable[[], None]
    """Lets others change the record; what was not committed is gone."""


class StateStore(Generic[StateT]):
    """One record in ``PATH`` and ``PATH.copy``, changed by any process, thread by thread.

    Each file is a line with the SHA-256 of all that follows, the record's name and its serial
    number, then the record as JSON. A change writes both anew, beside them, and flushes them to
    the disk before either takes its place: what a full disk or a cut can prevent changes nothing.
    The newest whole copy is the one that counts.

    ``PATH.lock`` is held during a change. It stays, and says that there were copies: that both of
    them are gone is told from a record that was never written.

    Args:
        path: path of the record, in a folder that exists when it is changed.
        model: model of the record.
        lost: consequence where no copy is whole, in words for whoever must act.
        report: takes what was damaged.
        name: name inside the record; that of the file by default.
    """

    def __init__(
        self,
        path: Path,
        model: type[StateT],
        *,
        lost: str,
        report: Report = log_fault,
        name: str = "",
    ) -> None:
        self.patience = 5.0
        """How long another process may keep the record to itself [s]."""
        self._model, self._lost, self._report = model, lost, report
        self._name = name or path.stem
        self._told = ""
        self._lock = path.with_name(f"{path.name}.lock")
        self._paths = (path, path.with_name(f"{path.name}.copy"))

    @property
    def version(self) -> tuple[int, int, int] | None:
        """Differs from what it was if the record was changed; costs no more than a look."""
        try:
            found = self._paths[0].stat()
        except OSError:
            return None
        return found.st_ino, found.st_mtime_ns, found.st_size

    @property
    def lost(self) -> bool:
        """True where the last :meth:`read` found no whole copy of two."""
        return self._told == "state_lost"

    def read(self) -> StateT | None:
        """Return the record that was written last; None if there is none, or none is whole.

        Raises:
            StorageError: a copy cannot be read; nothing was moved.
        """
        try:
            copies = self._copies()
        except OSError as error:
            raise StorageError(
                f"{Path(str(error.filename)).name} cannot be read ({error.strerror}): 'veilcamd "
                "doctor' on the camera's machine says what to do"
            ) from None
        if not self._differ(copies):
            self._told = ""
            return _newest(copies).state
        try:
            with self._locked(0.0):
                copies = self._copies()
                repaired = self._repair(copies)
        except OSError:
            # Another process is changing it, or the disk takes nothing: the next change repairs it.
            repaired = False
        self._tell(copies, repaired=repaired)
        return _newest(copies).state

    def change(self, update: Callable[[StateT | None], StateT]) -> StateT:
        """Replace the record by what ``update`` makes of it; it is on the disk at return.

        Raises:
            StorageError: the disk refuses, or another process keeps it. The record is what it was;
                if the disk failed between the two copies' changes of names, it is either.
        """
        with closing(self.stage(update)) as staged:
            staged.commit()
            return staged.state

    def stage(self, update: Callable[[StateT | None], StateT]) -> Staged[StateT]:
        """Begin a change whose end must not fail: a full disk prevents it here, if at all.

        Returns:
            What makes it hold. Nobody else changes the record before that is closed.

        Raises:
            StorageError: as :meth:`change`.
        """
        with self._telling(), ExitStack() as undo:
            lock = undo.enter_context(self._locked(self.patience))
            copies = self._copies()
            if self._differ(copies):
                self._tell(copies, repaired=self._repair(copies))
            newest = _newest(copies)
            state = update(newest.state)
            undo.callback(self._discard)
            self._write_beside(self._encode(state, newest.serial + 1))

            def commit() -> None:
                with self._telling():
                    self._put_in_place()
                self._told = ""
                if os.fstat(lock).st_size == 0:
                    with suppress(OSError):  # the next change does it
                        os.write(lock, b"written\n")

            return Staged(state, commit, undo.pop_all().close)

    def _encode(self, state: StateT, serial: int) -> bytes:
        content = f"{self._name} {serial}\n{state.model_dump_json()}\n".encode()
        return sha256(content).hexdigest().encode() + b" " + content

    def _decode(self, content: bytes) -> tuple[int, StateT]:
        """Return serial number and record; raises :class:`ValueError` for a damaged file."""
        digest, _, rest = content.partition(b" ")
        if sha256(rest).hexdigest().encode() != digest:
            raise ValueError("its checksum is wrong")
        head, _, record = rest.partition(b"\n")
        name, _, serial = head.rpartition(b" ")
        if name.decode() != self._name:
            raise _OtherRecordError
        return int(serial), self._model.model_validate_json(record)

    def _copies(self) -> tuple[_Copy[StateT], ...]:
        return tuple(self._copy(path) for path in self._paths)

    def _copy(self, path: Path) -> _Copy[StateT]:
        try:
            content = read_file(path, MAX_BYTES)
            serial, state = self._decode(content)
        except FileNotFoundError:
            return _Copy(path, fault="is gone")
        except (_OtherRecordError, ValidationError):
            return _Copy(path, fault="holds another record")
        except ValueError:
            return _Copy(path, fault="is damaged")
        return _Copy(path, content, serial, state)

    def _differ(self, copies: Sequence[_Copy[StateT]]) -> bool:
        """Return whether there is something to repair or to tell."""
        if any(copy.fault not in ("", "is gone") for copy in copies):
            return True
        return self._written() and not copies[0].content == copies[1].content != b""

    def _written(self) -> bool:
        """Return whether both copies were there once."""
        try:
            return self._lock.stat().st_size > 0
        except OSError:
            return False

    def _repair(self, copies: Sequence[_Copy[StateT]]) -> bool:
        """Set aside what is damaged, and write the newest whole copy in its place.

        Returns:
            Whether both copies are whole.
        """
        for copy in copies:
            if copy.fault not in ("", "is gone"):
                copy.path.replace(_aside(copy.path))
        newest = _newest(copies)
        if newest.state is None:
            return False
        if any(copy.content != newest.content for copy in copies):
            try:
                self._write_beside(newest.content)
                self._put_in_place()
            finally:
                self._discard()
        return True

    def _tell(self, copies: Sequence[_Copy[StateT]], *, repaired: bool) -> None:
        told = [copy for copy in copies if copy.fault]
        if not told or not (self._written() or any(copy.fault != "is gone" for copy in copies)):
            return
        what = " and ".join(f"{copy.path.name} {copy.fault}" for copy in told)
        if len(told) < len(copies):
            end = "was put right" if repaired else "cannot be put right now: check the disk"
            fault = ProblemError("state_damaged", f"{what}: its other copy is used, and it {end}")
        else:
            kept = [_aside(copy.path).name for copy in told if _aside(copy.path).exists()]
            rest = f"; what was left is in {' and '.join(kept)}" if kept else ""
            fault = ProblemError("state_lost", f"{what}: {self._lost}{rest}")
        # A loss stays until the next change, which need not tell of it again.
        if fault.code != self._told:
            self._report(fault)
        self._told = fault.code

    def _write_beside(self, content: bytes) -> None:
        for path in self._paths:
            descriptor = open_file(_new(path), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            with os.fdopen(descriptor, "wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())

    @contextmanager
    def _telling(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise StorageError(
                f"{self._lock.stem} cannot be written ({error.strerror}), and is what it was: "
                "check the state directory's disk"
            ) from None

    def _put_in_place(self) -> None:
        # The record itself comes last: who sees it change finds both changed.
        for path in reversed(self._paths):
            _new(path).replace(path)
        sync_folder(self._lock.parent)

    def _discard(self) -> None:
        for path in self._paths:
            with suppress(OSError):
                _new(path).unlink()

    @contextmanager
    def _locked(self, patience: float) -> Iterator[int]:
        lock = open_file(self._lock, os.O_RDWR | os.O_CREAT)
        try:
            lock_within(lock, patience)
            yield lock
        finally:
            os.close(lock)


class _OtherRecordError(ValueError):
    """A whole record of another name."""


class HeldDirectory:
    """A state directory that no other daemon uses meanwhile; made, for its owner alone.

    Args:
        directory: directory to hold until it is closed.

    Raises:
        StartError: another daemon holds it, or it cannot be used.
    """

    def __init__(self, directory: Path) -> None:
        try:
            make_directory(directory)
            # The folder itself: a file for it could not be made on a full disk.
            self._descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
        except OSError as error:
            raise unusable(directory, error) from None
        try:
            require_usable(directory)
        except StartError:
            os.close(self._descriptor)
            raise
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(self._descriptor)
            if not isinstance(error, BlockingIOError):
                raise unusable(directory, error) from None
            raise StartError(
                f"another veilcamd uses {directory}: stop it, or give another --state-dir"
            ) from None

    @property
    def closed(self) -> bool:
        """Return whether another daemon may have it now."""
        return self._descriptor < 0

    def close(self) -> None:
        """Let another daemon have it; twice does no harm."""
        if not self.closed:
            os.close(self._descriptor)
        self._descriptor = -1


def make_directory(directory: Path) -> None:
    """Make a folder for its owner alone, durably, unless it is there; raises :class:`OSError`."""
    if not directory.is_dir():
        directory.mkdir(parents=True, exist_ok=True, mode=0o700)
        directory.chmod(0o700)  # whatever the umask says
        sync_folder(directory.parent)


def _newest(copies: Sequence[_Copy[StateT]]) -> _Copy[StateT]:
    return max(copies, key=lambda copy: copy.serial)


def _new(path: Path) -> Path:
    return path.with_name(f"{path.name}.new")


def _aside(path: Path) -> Path:
    return path.with_name(f"{path.name}.damaged")


def lock_within(descriptor: int, patience: float) -> None:
    """Keep a file to this process; raises :class:`TimeoutError` where another keeps it [s]."""
    until = time.monotonic() + patience
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= until:
                raise TimeoutError(errno.ETIMEDOUT, "another process keeps it") from None
            time.sleep(_PAUSE)
        else:
            return
