"""Keys on the disk: whole lines count, old ones go, and nothing is in them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from veilcam_server.errors import StartError
from veilcam_server.security.key_record import LIFETIME, KeyRecord

KEYS = [bytes([number]) * 32 for number in range(200)]


class Clocks:
    """A record whose clocks a test sets."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.now = 1_000_000.0
        self.elapsed = 0.0

    def record(self) -> KeyRecord:
        record = KeyRecord(self.directory, lambda: self.now, lambda: self.elapsed)
        record.read()
        return record

    def read(self) -> list[int]:
        """Numbers of the keys that a start now knows."""
        return sorted(name[0] for name in self.record().read())

    def pass_by(self, seconds: float) -> None:
        self.now += seconds
        self.elapsed += seconds


@pytest.fixture
def clocks(tmp_path: Path) -> Clocks:
    return Clocks(tmp_path)


def test_key_written_is_known_for_a_minute(clocks: Clocks) -> None:
    record = clocks.record()
    record.add(KEYS[1], KEYS[2])
    assert clocks.record().read() == {KEYS[1]: KEYS[2]}
    clocks.pass_by(LIFETIME - 1)
    assert clocks.read() == [1]
    clocks.pass_by(2)
    assert clocks.read() == []


def test_files_take_turns_and_nothing_is_lost_within_the_minute(clocks: Clocks) -> None:
    record = clocks.record()
    for number in range(200):
        record.add(KEYS[number], KEYS[0])
        known = clocks.read()
        assert known == list(range(max(0, number - 9), number + 1))
        assert sum(path.stat().st_size for path in clocks.directory.iterdir()) < 20 * 160
        clocks.pass_by(LIFETIME / 10 + 0.001)


def test_start_goes_on_in_the_file_of_the_one_before(clocks: Clocks) -> None:
    for number in range(60):
        record = clocks.record()
        record.add(KEYS[number], KEYS[0])
        assert clocks.read() == list(range(max(0, number - 5), number + 1))
        clocks.pass_by(LIFETIME / 6 + 0.001)
    assert sum(path.stat().st_size for path in clocks.directory.iterdir()) < 20 * 160


def test_clock_that_was_set_back_forgets_nothing(clocks: Clocks) -> None:
    clocks.record().add(KEYS[1], KEYS[0])
    clocks.now -= 365 * 86_400
    assert clocks.read() == [1]


def test_only_whole_lines_count(clocks: Clocks, capsys: pytest.CaptureFixture[str]) -> None:
    record = clocks.record()
    for number in (1, 2, 3):
        record.add(KEYS[number], KEYS[0])
    [path] = clocks.directory.iterdir()
    whole = path.read_bytes()
    assert clocks.read() == [1, 2, 3]
    assert "damaged" not in capsys.readouterr().out
    path.write_bytes(whole[:-20])
    assert clocks.read() == [1, 2]
    assert "lines=1" in capsys.readouterr().out
    # What is written after half a line is whole.
    record.add(KEYS[4], KEYS[0])
    assert clocks.read() == [1, 2, 4]
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 4
    path.write_bytes(flipped)
    assert clocks.read() == [1, 3]
    path.write_bytes(b"")
    assert clocks.read() == []
    path.unlink()
    path.mkdir()
    with pytest.raises(StartError, match=r"idempotency-\d cannot be read \(Is a directory\)"):
        clocks.read()


def test_record_is_for_its_owner_alone_and_synced(
    clocks: Clocks, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[int] = []
    monkeypatch.setattr(os, "fdatasync", synced.append)
    clocks.record().add(KEYS[1], KEYS[0])
    assert len(synced) == 1
    [path] = clocks.directory.iterdir()
    assert path.stat().st_mode & 0o777 == 0o600


def test_disk_that_takes_half_a_line_refuses_it(
    clocks: Clocks, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = os.write
    monkeypatch.setattr(os, "write", lambda file, line: write(file, line[:50]))
    record = clocks.record()
    with pytest.raises(OSError, match="No space left"):
        record.add(KEYS[1], KEYS[0])
    monkeypatch.undo()
    record.add(KEYS[2], KEYS[0])
    assert clocks.read() == [2]
