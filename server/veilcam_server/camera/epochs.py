"""Epochs: their durable counter, and the next one, made ready in the background."""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from veilcam_server.errors import EpochError, NotReadyError, StartError
from veilcam_server.masks.source import Mask, MaskSource


class EpochStore:
    """The counter in ``DIRECTORY/epochs.sqlite3``, for one process at a time.

    At every start the counter is moved up to the clock (microseconds since 1970), far above what
    counting alone can have reached. So a state directory that was lost, or restored from a backup,
    brings no old epoch back, as long as the clock is right; and if it is not, what was counted
    holds.
    """

    def __init__(self, directory: Path, now: Callable[[], float] = time.time) -> None:
        path = directory / "epochs.sqlite3"
        self._lock = threading.Lock()
        try:
            directory.mkdir(parents=True, exist_ok=True, mode=0o700)
            # Two threads use it, one prepares epochs and one shows them; the lock parts them.
            self._database = sqlite3.connect(
                path, timeout=0, isolation_level=None, check_same_thread=False
            )
            # EXCLUSIVE from the first access on: a second daemon would show the same epochs.
            self._database.execute("PRAGMA locking_mode = EXCLUSIVE")
            self._database.execute("PRAGMA journal_mode = WAL")
            self._database.execute("PRAGMA synchronous = FULL")
            for table, column in (("epoch", "counter INTEGER"), ("shown", "mark TEXT")):
                self._database.execute(
                    f"CREATE TABLE IF NOT EXISTS {table} ("
                    f"one INTEGER PRIMARY KEY CHECK (one = 1), {column} NOT NULL) STRICT"
                )
            self._database.execute("INSERT OR IGNORE INTO epoch VALUES (1, 0)")
            self._database.execute("INSERT OR IGNORE INTO shown VALUES (1, '')")
            self._database.execute(
                "UPDATE epoch SET counter = max(counter, ?)", (int(1e6 * now()),)
            )
            self._mark = str(self._database.execute("SELECT mark FROM shown").fetchone()[0])
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode == sqlite3.SQLITE_BUSY:
                raise StartError(
                    f"another veilcamd uses {directory}: stop it, or give another --state-dir"
                ) from None
            raise _unusable(path, error) from None
        except (sqlite3.DatabaseError, OSError) as error:
            raise _unusable(path, error) from None

    def next(self) -> int:
        """Commit the next epoch to the disk, then return its counter.

        Raises:
            EpochError: it could not be made durable.
        """
        return self._commit("UPDATE epoch SET counter = counter + 1 RETURNING counter", ())[0][0]

    @property
    def mark(self) -> str:
        """Mark of the mask shown last, or about to be; empty if there was none."""
        return self._mark

    @mark.setter
    def mark(self, mark: str) -> None:
        if mark != self._mark:
            self._commit("UPDATE shown SET mark = ?", (mark,))
            self._mark = mark

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def _commit(self, statement: str, values: tuple[str, ...]) -> list[tuple[int, ...]]:
        try:
            with self._lock:
                return self._database.execute(statement, values).fetchall()
        except sqlite3.DatabaseError as error:
            raise EpochError(
                f"the mask epoch cannot be recorded ({error}): check the state directory's disk"
            ) from None


def _unusable(path: Path, error: Exception) -> StartError:
    return StartError(f"{path} cannot be used ({error}): check it, or give another --state-dir")


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
