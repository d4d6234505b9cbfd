"""Mask epochs: one showing of one mask. Durable before the panel shows it, never used twice.

The counter is what key derivation takes; the network only ever sees a name.
"""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from veilcam_server.errors import EpochError, StartError


@dataclass(frozen=True, slots=True)
class Epoch:
    """``name`` goes over the wire, ``counter`` grows for ever and stays here."""

    counter: int
    name: str


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
        row = self._commit("UPDATE epoch SET counter = counter + 1 RETURNING counter", ())
        return row[0][0]

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

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

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
