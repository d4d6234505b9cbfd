"""The clock of a machine whose zone changes, and what the kernel says of it."""

from __future__ import annotations

import ctypes
import os
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from veilcam_client.wire.status import WallClock
from veilcam_server.system import clock as clocks
from veilcam_server.system.clock import ZONES, MachineClock, kernel_synchronised

TOKYO, UTC_FILE = ZONES / "Asia/Tokyo", ZONES / "Etc/UTC"


def hours(clock: MachineClock) -> float:
    offset = clock.now().utcoffset()
    assert offset is not None
    assert abs(clock.now() - datetime.now(UTC)) < timedelta(minutes=1)
    return offset / timedelta(hours=1)


def replace(file: Path, zone: Path) -> None:
    other = file.with_name("new")
    shutil.copy(zone, other)
    other.replace(file)


def rewrite(file: Path, zone: Path) -> None:
    """Write the same file again, of the same age: the C library does not notice."""
    was = file.stat()
    with file.open("r+b") as writing:
        writing.truncate()
        writing.write(zone.read_bytes())
    os.utime(file, ns=(was.st_atime_ns, was.st_mtime_ns))


def link(file: Path, zone: Path) -> None:
    other = file.with_name("new")
    other.symlink_to(zone)
    other.replace(file)


@pytest.fixture
def localtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    file = tmp_path / "localtime"
    shutil.copy(UTC_FILE, file)
    monkeypatch.delenv("TZ", raising=False)
    monkeypatch.setattr(clocks, "LOCAL", file)
    return file


@pytest.mark.parametrize("change", [replace, rewrite, link])
@pytest.mark.parametrize("named", [False, True])
def test_zone_that_changes_is_noticed(
    localtime: Path, monkeypatch: pytest.MonkeyPatch, change: Any, *, named: bool
) -> None:
    if named:
        monkeypatch.setenv("TZ", f":{localtime}")
    clock = MachineClock()
    assert (hours(clock), clock.told().zone) == (0, "UTC")
    change(localtime, TOKYO)
    assert hours(clock) == 9
    assert clock.told().zone == ("Asia/Tokyo" if change is link else "JST")
    change(localtime, UTC_FILE)
    assert hours(clock) == 0


def test_zone_file_that_is_half_written_changes_nothing(localtime: Path) -> None:
    clock = MachineClock()
    rewrite(localtime, TOKYO)
    assert hours(clock) == 9
    for half in (b"", b"TZif", TOKYO.read_bytes()[:60]):
        localtime.write_bytes(half)
        assert hours(clock) == 9
    localtime.write_bytes(UTC_FILE.read_bytes())
    assert hours(clock) == 0


@pytest.mark.parametrize("named", [False, True])
def test_zone_that_is_removed_is_utc(
    localtime: Path, monkeypatch: pytest.MonkeyPatch, *, named: bool
) -> None:
    if named:
        monkeypatch.setenv("TZ", str(localtime))
    clock = MachineClock()
    rewrite(localtime, TOKYO)
    assert hours(clock) == 9
    localtime.unlink()
    assert (hours(clock), clock.told().zone) == (0, "UTC")


@pytest.mark.parametrize(
    ("given", "offset", "name"),
    [
        ("Asia/Tokyo", 9, "Asia/Tokyo"),
        (":Asia/Tokyo", 9, "Asia/Tokyo"),
        ("", 0, str((ZONES / "UTC").resolve().relative_to(ZONES))),
    ],
)
def test_zone_of_the_environment_is_named(
    monkeypatch: pytest.MonkeyPatch, given: str, offset: int, name: str
) -> None:
    monkeypatch.setenv("TZ", given)
    clock = MachineClock(kernel=lambda: True)
    assert hours(clock) == offset
    assert clock.told() == WallClock(zone=name, synchronised=True)


@pytest.mark.parametrize(
    ("state", "status", "synchronised"),
    [(0, 0x2001, True), (0, 0, True), (5, 0x0040, False), (5, 0x2041, False), (-1, 0, False)],
)
def test_kernel_is_asked_and_changes_nothing(
    monkeypatch: pytest.MonkeyPatch, state: int, status: int, *, synchronised: bool
) -> None:
    def adjtimex(pointer: Any) -> int:
        asked = pointer._obj
        assert asked.modes == 0
        assert ctypes.sizeof(asked) >= 208
        asked.status = status
        return state

    monkeypatch.setattr(ctypes, "CDLL", lambda _: SimpleNamespace(adjtimex=adjtimex))
    assert kernel_synchronised() is synchronised


def test_kernel_that_cannot_be_asked_vouches_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ctypes, "CDLL", lambda _: SimpleNamespace())
    assert not kernel_synchronised()


def test_clock_that_was_synchronised_once_is_right_from_then_on() -> None:
    told = [False]
    clock = MachineClock(kernel=lambda: told[0])
    assert not clock.sure()
    told[0] = True
    assert clock.sure()
    told[0] = False
    assert clock.sure()
    assert not clock.told().synchronised
    assert MachineClock(trusted=True, kernel=lambda: False).sure()
