"""Mask epochs outlive the process and are never used twice."""

from __future__ import annotations

import errno
import itertools
import json
import secrets
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from tests.server.damage import DAMAGES

from veilcam_server.camera.epochs import RESERVED, EpochStore
from veilcam_server.errors import EpochError, ProblemError, StartError

YEAR = 365.25 * 86_400


def no_clock() -> float:
    return 0.0


def record(directory: Path) -> dict[str, Any]:
    """What stands on the disk, without the checksum."""
    found: dict[str, Any] = json.loads((directory / "epochs.json").read_text().splitlines()[1])
    return found


def some(directory: Path, now: Callable[[], float] = no_clock, count: int = 3) -> list[int]:
    """So many epochs of one daemon."""
    with closing(EpochStore(directory, now)) as store:
        return [store.next() for _ in range(count)]


def test_the_counter_goes_on_after_a_restart(tmp_path: Path) -> None:
    first = some(tmp_path, count=3)
    assert first == [first[0], first[0] + 1, first[0] + 2]
    # What was made durable and not used is left out.
    assert some(tmp_path)[0] == first[0] + RESERVED


def test_no_epoch_is_given_that_is_not_durable(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path, no_clock)) as store:
        for _ in range(2 * RESERVED + 1):
            assert store.next() <= record(tmp_path)["counter"]


def test_the_disk_is_written_once_for_many_epochs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with closing(EpochStore(tmp_path, no_clock)) as store:
        change, changes = store._file.change, 0

        def counted(update: Any) -> Any:
            nonlocal changes
            changes += 1
            return change(update)

        monkeypatch.setattr(store._file, "change", counted)
        given = [store.next() for _ in range(2 * RESERVED)]
        assert given == list(range(given[0], given[0] + 2 * RESERVED))
        assert changes == 2


def test_a_directory_of_yesterday_brings_no_epoch_back(tmp_path: Path) -> None:
    some(tmp_path, lambda: 1000.0, 1)
    files = [tmp_path / name for name in ("epochs.json", "epochs.json.copy")]
    backup = [file.read_bytes() for file in files]
    last = some(tmp_path, lambda: 2000.0, 2 * RESERVED)[-1]
    for file, content in zip(files, backup, strict=True):
        file.write_bytes(content)
    assert some(tmp_path, lambda: 2000.5)[0] > last


def test_a_clock_that_goes_back_is_no_harm(tmp_path: Path) -> None:
    last = some(tmp_path, lambda: 2 * YEAR)[-1]
    assert last < some(tmp_path, lambda: YEAR)[0] <= last + RESERVED


def test_a_lost_record_brings_no_epoch_back_whatever_the_clock_says(tmp_path: Path) -> None:
    """Of 30 lost records, some at the same time and some a year earlier, none meets another."""
    spans: list[tuple[int, int]] = []
    for number in range(30):
        given = some(tmp_path / str(number), lambda number=number: YEAR * (number % 3), 2)  # type: ignore[misc]
        spans.append((given[0], given[0] + 10**9))
    # A thousand million epochs each: two of the 435 pairs meet with a chance below 1e-7.
    for (_, end), (begin, _) in itertools.pairwise(sorted(spans)):
        assert end < begin


def test_a_new_record_begins_at_a_random_number_of_63_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    def most(bits: int) -> int:
        asked.append(bits)
        return 2**63 - 1

    monkeypatch.setattr(secrets, "randbits", most)
    assert some(tmp_path, lambda: 1.8e9 + 0.25)[:2] == [
        2**63 + 1_800_000_000_250_000,
        2**63 + 1_800_000_000_250_001,
    ]
    assert asked == [63]
    # The largest there are still fit the eight bytes that masks and names are made of.
    assert some(tmp_path, lambda: 1e4 * YEAR)[-1] < 2**64
    assert asked == [63]


def test_the_clock_of_this_machine_is_the_one_that_counts(tmp_path: Path) -> None:
    before = 1e6 * time.time()
    with closing(EpochStore(tmp_path)) as store:
        counter = store.next() - record(tmp_path)["origin"]
    assert before <= counter <= 1e6 * time.time() + 1


def test_the_mark_of_the_mask_shown_last_is_kept(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path)) as store:
        assert store.mark == ""
        store.mark = "a1"
        given = store.next()
    with closing(EpochStore(tmp_path)) as store:
        assert store.mark == "a1"
        store.mark = "b2"
        assert store.next() > given


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
    assert some(tmp_path)[0] > int(killed.stdout.split()[-1])


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_record_is_put_right_from_its_copy(
    tmp_path: Path, damage: Callable[[Path], None]
) -> None:
    first = some(tmp_path)
    damage(tmp_path / "epochs.json")
    faults: list[ProblemError] = []
    with closing(EpochStore(tmp_path, no_clock, faults.append)) as store:
        assert store.next() == first[0] + RESERVED
    assert [fault.code for fault in faults] == ["state_damaged"]


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_lost_record_is_told_and_begun_anew(
    tmp_path: Path, damage: Callable[[Path], None]
) -> None:
    first = some(tmp_path)
    for name in ("epochs.json", "epochs.json.copy"):
        damage(tmp_path / name)
    faults: list[ProblemError] = []
    with closing(EpochStore(tmp_path, no_clock, faults.append)) as store:
        # 2 N / 2^63 for N = 1000: it never happens.
        assert abs(store.next() - first[0]) > RESERVED
    (fault,) = faults
    assert fault.code == "state_lost"
    assert "epochs go on from a random number" in str(fault)


def test_two_daemons_cannot_share_a_state_directory(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path)), pytest.raises(StartError, match="another veilcamd uses"):
        EpochStore(tmp_path)


def test_what_an_earlier_version_left_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "epochs.sqlite3").touch()
    for _ in range(2):  # and the directory is not held meanwhile
        with pytest.raises(StartError, match=r"epochs\.sqlite3 is of an earlier version: remove"):
            EpochStore(tmp_path)


def test_a_directory_that_cannot_be_one_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(StartError, match=r"file cannot be used .* --state-dir"):
        EpochStore(tmp_path / "file")


def test_one_thread_prepares_epochs_and_another_shows_them(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path, no_clock)) as store, ThreadPoolExecutor(1) as other:
        first = other.submit(store.next).result()
        store.mark = "a1"
        assert other.submit(lambda: store.mark).result() == "a1"
        assert store.next() == first + 1


def test_a_mark_is_written_where_it_is_another_one_alone(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path, no_clock)) as store:
        store.mark = "a1"
        written = (tmp_path / "epochs.json").read_bytes()
        store.mark = "a1"
        assert (tmp_path / "epochs.json").read_bytes() == written
        store.mark = "b2"
        assert record(tmp_path)["mark"] == store.mark == "b2"


def test_a_store_that_was_closed_lets_go_of_the_directory_and_writes_no_more(
    tmp_path: Path,
) -> None:
    store = EpochStore(tmp_path, no_clock)
    store.close()
    with closing(EpochStore(tmp_path, no_clock)) as again:
        last = again.next()
        for write in (store.next, lambda: setattr(store, "mark", "a1")):
            with pytest.raises(EpochError, match="the daemon has ended"):
                write()
        assert record(tmp_path)["counter"] >= last


def test_what_cannot_be_recorded_is_an_error_and_not_an_epoch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(update: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with closing(EpochStore(tmp_path, no_clock)) as store:
        with monkeypatch.context() as patch:
            patch.setattr(store._file, "change", full)
            with pytest.raises(EpochError, match=r"recorded \(No space .*: check the state direct"):
                store.next()
            with pytest.raises(EpochError):
                store.mark = "b2"
            assert store.mark == ""
        first = store.next()
        with monkeypatch.context() as patch:
            patch.setattr(store._file, "change", full)
            # What is durable already can be used.
            rest = [store.next() for _ in range(RESERVED - 1)]
            with pytest.raises(EpochError):
                store.next()
        assert store.next() == rest[-1] + 1 == first + RESERVED


def test_nothing_but_numbers_and_a_mark_is_stored(tmp_path: Path) -> None:
    with closing(EpochStore(tmp_path, no_clock)) as store:
        store.next()
        store.mark = "a1"
    found = record(tmp_path)
    assert found == {
        "origin": found["origin"],
        "counter": found["origin"] + RESERVED,
        "mark": "a1",
    }
