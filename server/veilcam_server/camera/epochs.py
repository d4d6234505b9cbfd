"""Epochs: their durable counter, and the next one, made ready in the background."""

from __future__ import annotations

import errno
import secrets
import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from veilcam_server.errors import EpochError, NotReadyError
from veilcam_server.masks.source import Mask, MaskSource
from veilcam_server.system.state_file import (
    HeldDirectory,
    Report,
    StateFile,
    log_fault,
    refuse_earlier,
)

RESERVED = 1000
"""So many epochs are made durable at once: the disk is not written for each."""


class _Epochs(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")
    origin: int
    """Random number of 63 bits, drawn for a new record."""
    counter: int
    """No epoch above this one was used."""
    mark: str = ""
    """Of the mask shown last, or about to be; empty if there was none."""


class EpochStore:
    """The counter in ``DIRECTORY/epochs.json``, for one process at a time.

    The counter is made durable in advance, ``RESERVED`` epochs at a time; what was not used of
    them when the daemon ends is left out for ever.

    A record that is lost is begun anew at a random number of 63 bits. Whatever the clock says, N
    epochs before and N after it have one in common with a chance below 2 N / 2^63, which is 2e-10
    for a thousand million of them. At every start the counter is moved up by the clock as well, in
    microseconds since 1970 from where the record began: that is far above what counting can have
    reached, so that a directory restored from a backup brings no epoch back if the clock is right.

    Args:
        directory: the daemon's state directory, held until this is closed.
        now: wall clock, seconds since 1970.
        report: takes what was damaged.

    Raises:
        StartError: another daemon uses the directory, or it cannot be used.
    """

    def __init__(
        self, directory: Path, now: Callable[[], float] = time.time, report: Report = log_fault
    ) -> None:
        self._held = HeldDirectory(directory)
        self._file = StateFile(
            directory / "epochs.json",
            _Epochs,
            lost="epochs go on from a random number",
            report=report,
        )
        try:
            refuse_earlier(directory / "epochs.sqlite3", "remove it, and start again")
            record = self._file.read()
        except BaseException:
            self._held.close()
            raise
        if record is None:
            record = _Epochs(origin=secrets.randbits(63), counter=0)
        self._counter = max(record.counter, record.origin + int(1e6 * now()))
        self._record = record.model_copy(update={"counter": self._counter})
        # Two threads use it, one prepares epochs and one shows them.
        self._lock = threading.Lock()

    def next(self) -> int:
        """Return the next epoch, which was made durable before.

        Raises:
            EpochError: it could not be made durable.
        """
        with self._lock:
            if self._counter == self._record.counter:
                self._write(counter=self._counter + RESERVED)
            self._counter += 1
            return self._counter

    @property
    def mark(self) -> str:
        """Mark of the mask shown last, or about to be; empty if there was none."""
        return self._record.mark

    @mark.setter
    def mark(self, mark: str) -> None:
        with self._lock:
            if mark != self._record.mark:
                self._write(mark=mark)

    def close(self) -> None:
        """Let another daemon have the directory; nothing is recorded from now on."""
        self._held.close()

    def _write(self, **changes: int | str) -> None:
        record = self._record.model_copy(update=changes)
        try:
            if self._held.closed:
                raise OSError(errno.EBADF, "the daemon has ended")
            self._file.change(lambda _: record)
        except OSError as error:
            raise EpochError(
                f"the mask epoch cannot be recorded ({error.strerror}): "
                "check the state directory's disk"
            ) from None
        self._record = record


LONGEST = 60.0
"""Longest wait for one epoch [s]."""


@dataclass(frozen=True, eq=False, slots=True)
class Prepared:
    """An epoch that is durable, its mask, and what reads behind it."""

    epoch: str
    """Its name, which goes over the wire; the counter grows for ever and stays here."""
    mask: Mask = field(repr=False)


class Preparation:
    """Prepares one epoch ahead. All but the properties is called by one thread at a time.

    An epoch is committed to the disk before anything is drawn for it. One that is prepared and not
    shown, because the daemon ended, is left out for ever.

    Args:
        source: of masks.
        epochs: where epochs are recorded; closed with this.
    """

    def __init__(self, source: MaskSource, epochs: EpochStore) -> None:
        self._source, self._epochs = source, epochs
        self._thread = ThreadPoolExecutor(1, "preparation")
        self._next: Future[Prepared] | None = None
        self.count = 0
        """How many epochs were prepared."""
        self.took = 0.0
        """How long the last preparation took [s]; 0 before the first."""

    @property
    def renewable(self) -> bool:
        """Whether there is another mask to change to."""
        return self._source.renewable

    @property
    def under_way(self) -> bool:
        """Whether to take the next epoch means to wait for it."""
        future = self._next
        return future is not None and not future.done()

    @property
    def ready(self) -> bool:
        """Whether the next epoch is prepared."""
        future = self._next
        return future is not None and future.done() and not future.exception()

    def begin(self) -> Future[Prepared]:
        """Start to prepare the next epoch, if none is prepared or under way, and return it."""
        if self._next is None:
            self._next = self._thread.submit(self._prepare, self._source)
        return self._next

    def wait(self) -> None:
        """Wait until none is under way, whatever came of it."""
        if self._next is not None:
            # Unlike `futures.wait`, this also ends where the future was called off in the queue.
            with suppress(CancelledError):
                self._next.exception()

    def take(self) -> Prepared:
        """Return the next epoch; waits for it if need be. It is gone from here, come what may.

        Raises:
            NotReadyError: it takes too long.
            EpochError: it could not be made durable.
        """
        future = self.begin()
        wait([future], LONGEST)
        if not future.done():
            raise NotReadyError("the next mask is still being prepared: try again")
        self._next = None
        return future.result()

    def first_of(self, source: MaskSource) -> Prepared:
        """Prepare an epoch of another source, while this one goes on; any thread may ask.

        Raises:
            NotReadyError: it takes too long.
            EpochError: it could not be made durable.
        """
        try:
            return self._thread.submit(self._prepare, source).result(LONGEST)
        except TimeoutError:
            raise NotReadyError("the first mask is still being prepared: try again") from None

    def serve(self, source: MaskSource) -> None:
        """Take epochs from another source from now on; one prepared before is left out."""
        self._source, self._next = source, None

    def record(self, mask: Mask) -> None:
        """Make durable that ``mask`` is about to be shown; raises :class:`EpochError`."""
        self._epochs.mark = mask.mark

    def close(self) -> None:
        """End the background thread and close the epochs; twice does no harm."""
        self._thread.shutdown(cancel_futures=True)
        self._epochs.close()

    def _prepare(self, source: MaskSource) -> Prepared:
        begun = time.perf_counter()
        counter = self._epochs.next()
        prepared = Prepared(source.name(counter), source.make(counter, self._epochs.mark))
        self.took = time.perf_counter() - begun
        self.count += 1
        return prepared
