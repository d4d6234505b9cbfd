"""Mask epochs outlive the process and are never used twice."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest

from veilcam_server.camera.epochs import EpochStore
from veilcam_server.errors import EpochError, StartError


def no_clock() -> float:
    return 0.0


def test_the_counter_goes_on_after_a_restart(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path, no_clock)) as store:
        first = [store.next() for _ in range(3)]
    with closing(EpochStore(tmp_path, no_clock)) as store:
        assert store.next() == first[-1] + 1 == 4


def test_a_lost_state_directory_brings_no_epoch_back(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path / "old", lambda: 1000.0)) as store:
        last = [store.next() for _ in range(100)][-1]
    with closing(EpochStore(tmp_path / "new", lambda: 1000.5)) as store:
        assert store.next() > last
    # A clock that stands or goes back is no harm while the directory is there.
    with closing(EpochStore(tmp_path / "old", lambda: 900.0)) as store:
        assert store.next() == last + 1


def test_the_clock_of_this_machine_is_the_one_that_counts(tmp_path: Path) -> None:
    before = 1e6 * time.time()
    with closing(EpochStore(tmp_path)) as store:
        assert before <= store.next() <= 1e6 * time.time() + 1


def test_the_mark_of_the_mask_shown_last_is_kept(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path)) as store:
        assert store.mark == ""
        store.mark = "a1"
    with closing(EpochStore(tmp_path)) as store:
        assert store.mark == "a1"


@pytest.mark.slow
def test_the_counter_survives_a_process_that_is_killed(tmp_path: Path) -> None:
    script = (
        "import os, pathlib, sys\n"
        "from veilcam_server.camera.epochs import EpochStore\n"
        "store = EpochStore(pathlib.Path(sys.argv[1]), lambda: 0.0)\n"
        "for _ in range(5): print(store.next(), flush=True)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    killed = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert killed.returncode == -9
    with closing(EpochStore(tmp_path, no_clock)) as store:
        assert store.next() == int(killed.stdout.split()[-1]) + 1


def test_every_commit_is_flushed_to_the_disk(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path)) as store:
        assert store._database.execute("PRAGMA synchronous").fetchone() == (2,)
        assert store._database.execute("PRAGMA journal_mode").fetchone() == ("wal",)


def test_two_daemons_cannot_share_a_state_directory(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path)), pytest.raises(StartError, match="another veilcamd uses"):
        EpochStore(tmp_path)


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "epochs.sqlite3").write_bytes(b"not a database at all, but long enough" * 100)
    with pytest.raises(StartError, match="cannot be used"):
        EpochStore(tmp_path)


def test_a_directory_that_cannot_be_one_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "taken" / "epochs.sqlite3").mkdir(parents=True)
    for directory in (tmp_path / "file", tmp_path / "taken"):
        # Nobody else uses it: to stop another daemon would not help.
        with pytest.raises(StartError, match=r"epochs\.sqlite3 cannot be used .* --state-dir"):
            EpochStore(directory)


def test_the_state_directory_is_private(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path / "new")):
        assert (tmp_path / "new").stat().st_mode & 0o777 == 0o700


def test_a_state_directory_is_made_where_none_is(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path / "var" / "lib" / "veilcam")):
        assert (tmp_path / "var" / "lib" / "veilcam" / "epochs.sqlite3").is_file()


def test_the_clock_counts_in_microseconds(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path, lambda: 1.8e9 + 0.25)) as store:
        assert [store.next(), store.next()] == [1_800_000_000_250_001, 1_800_000_000_250_002]


def test_one_thread_prepares_epochs_and_another_shows_them(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path, no_clock)) as store, ThreadPoolExecutor(1) as other:
        assert other.submit(store.next).result() == 1
        store.mark = "a1"
        assert other.submit(lambda: store.mark).result() == "a1"
        assert store.next() == 2


def test_a_mark_is_written_where_it_is_another_one_alone(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path, no_clock)) as store:
        store.mark = "a1"
        writes = store._database.total_changes
        store.mark = "a1"
        assert store._database.total_changes == writes
        store.mark = "b2"
        assert (store.mark, store._database.total_changes) == ("b2", writes + 1)


def test_a_store_that_was_closed_lets_go_of_the_directory(tmp_path: Path) -> None:
    store = EpochStore(tmp_path, no_clock)
    store.close()
    with closing(EpochStore(tmp_path, no_clock)) as again:
        assert again.next() == 1


def test_what_cannot_be_recorded_is_an_error_and_not_an_epoch(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path, no_clock)) as store:
        store.next()
        store.mark = "a1"
        store._database.execute("PRAGMA query_only = ON")
        with pytest.raises(EpochError, match=r"cannot be recorded .*: check the state directory"):
            store.next()
        with pytest.raises(EpochError):
            store.mark = "b2"
        assert store.mark == "a1"
        store._database.execute("PRAGMA query_only = OFF")
        assert store.next() == 2


def test_nothing_but_a_counter_and_a_mark_is_stored(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path, no_clock)) as store:
        store.next()
        store.mark = "a1"
    database = sqlite3.connect(tmp_path / "epochs.sqlite3")
    tables = database.execute("SELECT name FROM sqlite_master").fetchall()
    rows = database.execute("SELECT * FROM epoch, shown").fetchall()
    database.close()
    assert tables == [("epoch",), ("shown",)]
    assert rows == [(1, 1, 1, "a1")]
