"""The capture log: it goes on whatever befalls it, and says what did."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs
from tests.app.server.killing import kill_writers
from tests.unit.server.damage import DAMAGES

from veilcam_client.keys.capture_log import NOTHING_BEFORE, is_genuine, line_digest, line_of
from veilcam_client.wire.log import LoggedCapture, LogRecord
from veilcam_server.errors import ProblemError, StorageError
from veilcam_server.sealing import capture_log as module
from veilcam_server.sealing import segments as segments_module
from veilcam_server.sealing.capture_log import FOLDER, CaptureLog
from veilcam_server.sealing.identity import DeviceKey
from veilcam_server.sealing.segments import Segments

FULL = OSError(errno.ENOSPC, "No space left on device")
SMALL = 2000
"""Room for three records [bytes]."""


class Rig:
    def __init__(self, state_dir: Path) -> None:
        self.state_dir, self.key = state_dir, DeviceKey.open(state_dir)
        self.folder = state_dir / FOLDER
        self.faults: list[ProblemError] = []

    def open(self, **limits: int) -> CaptureLog:
        made = CaptureLog(Segments(self.folder, **limits), self.key)
        made.begin(self.faults.append)
        return made

    def life(self, captures: int, **limits: int) -> None:
        log = self.open(**limits)
        append(log, captures)
        log.close()

    def said(self, **limits: int) -> list[LogRecord]:
        """All records, as the next life shows them; and that they follow from each other."""
        log = CaptureLog(Segments(self.folder, **limits), self.key)
        records = log.records(None, 1_000_000).records
        log.close()
        assert all(map(is_genuine, records))
        for one, following in pairwise(records):
            assert following.position == one.position + 1
            assert following.previous == line_digest(line_of(one))
        # The life that shows them began with a record of its own.
        return list(records[:-1])


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path)


@pytest.fixture
def full(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """A disk that takes nothing until this is undone."""

    def refuse(*_: Any) -> int:
        raise FULL

    monkeypatch.setattr(os, "pwrite", refuse)
    return monkeypatch


def capture(number: int) -> LoggedCapture:
    return LoggedCapture(
        epoch="9f" * 16,
        number=number,
        taken_at=module._now(),
        mask="1a" * 32,
        tested_s=60,
        calibration=None,
        answer=f"{number:064x}",
    )


def append(log: CaptureLog, captures: int) -> None:
    for number in range(captures):
        log.append(capture(number))


def kinds(records: list[LogRecord]) -> list[str]:
    return [getattr(each.entry, "after", each.entry.kind) for each in records]


def test_log_tells_of_every_life_in_order(rig: Rig) -> None:
    rig.life(2)
    rig.life(1)
    records = rig.said()
    assert kinds(records) == ["nothing", "capture", "capture", "stop", "stop", "capture", "stop"]
    assert records[0].previous == NOTHING_BEFORE
    assert records[0].position == 0
    assert {each.device for each in records} == {rig.key.public}
    assert [each.entry for each in records[1:3]] == [capture(0), capture(1)]
    assert not rig.faults


def test_end_without_a_stop_is_said(rig: Rig) -> None:
    append(rig.open(), 1)
    rig.open()
    assert kinds(rig.said()) == ["nothing", "capture", "cut"]
    assert not rig.faults


def test_head_is_that_of_the_newest_record(rig: Rig) -> None:
    log = rig.open(limit=SMALL, kept=2)
    append(log, 8)
    head = log.head()
    newest = log.records(None, 100).records[-1]
    assert is_genuine(head)
    assert (head.position, head.record) == (newest.position, line_digest(line_of(newest)))
    assert head.oldest == log.records(None, 1).records[0].position > 0
    assert (head.missed, head.device) == (0, rig.key.public)


def test_dropped_records_are_said(rig: Rig) -> None:
    log = rig.open(limit=SMALL, kept=2)
    append(log, 20)
    records = log.records(None, 100).records
    said = [each.entry.before for each in records if each.entry.kind == "dropped"]
    assert said[-1] == records[0].position == log.head().oldest
    assert len(list(rig.folder.iterdir())) <= 3
    numbers = [each.entry.number for each in records if isinstance(each.entry, LoggedCapture)]
    assert numbers == list(range(numbers[0], 20))


def test_records_come_in_pages_over_all_files(rig: Rig) -> None:
    log = rig.open(limit=SMALL)
    append(log, 9)
    everything = log.records(None, 100)
    assert [each.position for each in everything.records] == list(range(10))
    assert everything.next is None
    found: list[LogRecord] = []
    after: int | None = None
    while page := log.records(after, 4).records:
        found += page
        after = page[-1].position
    assert tuple(found) == everything.records
    assert log.records(None, 4).next == 3
    assert log.records(7, 100).records == everything.records[8:]
    assert log.records(9, 4).records == log.records(99, 4).records == ()
    assert log.records(9, 4).next is None


def test_file_that_is_dropped_meanwhile_is_passed_over(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = rig.open(limit=SMALL)
    append(log, 9)
    files = log._segments.files(0)
    monkeypatch.setattr(log._segments, "files", lambda _: files)
    files[0][0].unlink()
    assert log.records(None, 100).records[0].position == 3


def test_records_shown_are_on_the_disk(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """A head that a power cut disowned would accuse an honest camera."""
    log = rig.open()
    append(log, 2)
    flushed: list[int] = []
    monkeypatch.setattr(os, "fsync", lambda file: flushed.append(os.fstat(file).st_size))
    append(log, 1)
    assert not flushed
    log.head()
    log.records(None, 1)
    log.close()
    sizes = sorted(flushed)
    size = (rig.folder / f"{0:020d}.jsonl").stat().st_size
    assert sizes[0] == sizes[1] < sizes[2] == size


def test_record_that_cannot_be_flushed_is_not_shown(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = rig.open()
    append(log, 1)
    descriptors = len(os.listdir("/proc/self/fd"))

    def fail(_: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fsync", fail)
    for look in (log.head, lambda: log.records(None, 1)):
        with pytest.raises(StorageError, match=r"Input/output error.*check the state"):
            look()
    assert len(os.listdir("/proc/self/fd")) == descriptors


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_log_goes_on_and_says_so(rig: Rig, damage: str) -> None:
    rig.life(5)
    DAMAGES[damage](rig.folder / f"{0:020d}.jsonl")
    rig.life(1)
    records = rig.said()
    if damage == "removed":  # as if there had been none: an empty folder says nothing
        assert kinds(records) == ["nothing", "capture", "stop"]
        return
    [fault] = rig.faults
    assert isinstance(fault, ProblemError)
    assert fault.remedy == "check_disk"
    [said] = [each.entry.after for each in records if each.entry.kind == "start"][-1:]
    if records[0].position == 0 and len(records) == 3:
        assert said == "loss"
        assert "is lost, and a new one begins; what was left is in capture-log.damaged" in str(
            fault
        )
    else:
        assert said == "damage"
        assert "its end is damaged and was set aside in capture-log.damaged" in str(fault)


def test_damage_before_the_end_is_said_at_every_start(rig: Rig) -> None:
    rig.life(5)
    path = rig.folder / f"{0:020d}.jsonl"
    path.write_bytes(path.read_bytes().replace(f"{2:064x}".encode(), f"{3:064x}".encode()))
    for _ in range(2):
        rig.faults.clear()
        log = rig.open()
        [fault] = rig.faults
        assert "records are damaged or missing in 1 places" in str(fault)
        assert log.records(None, 100).records[-1].entry.after == "damage"  # type: ignore[union-attr]
        assert len(log.records(None, 100).records) == log.head().position + 1
        log.close()


def test_line_that_is_none_is_left_out(rig: Rig) -> None:
    log = rig.open()
    append(log, 3)
    path = rig.folder / f"{0:020d}.jsonl"
    lines = path.read_bytes().split(b"\n")
    for damaged in (b"x" * len(lines[2]), lines[2].replace(b"capture", b"captxre")):
        path.write_bytes(b"\n".join([*lines[:2], damaged, *lines[3:]]))
        assert [each.position for each in log.records(None, 100).records] == [0, 1, 3]


def test_log_of_another_device_is_set_aside(rig: Rig) -> None:
    rig.life(3)
    other = Rig(rig.state_dir / "other")
    log = CaptureLog(Segments(rig.folder), other.key)
    log.begin(rig.faults.append)
    assert len(rig.faults) == 1
    assert log.records(None, 9).records[0].entry.after == "loss"  # type: ignore[union-attr]
    assert list((rig.state_dir / "capture-log.damaged").iterdir())


def test_full_disk_stops_no_answer_and_the_gap_is_said(rig: Rig, full: pytest.MonkeyPatch) -> None:
    full.undo()
    log = rig.open()
    append(log, 1)
    full.setattr(os, "pwrite", lambda *_: 5)
    append(log, 3)
    [fault] = rig.faults  # once, however many answers
    assert isinstance(fault, StorageError)
    assert "No space left on device" in str(fault)
    head = log.head()
    assert is_genuine(head)
    assert (head.position, head.missed) == (1, 3)
    full.undo()
    with capture_logs() as logs:
        append(log, 2)
    assert logs == [{"event": "capture log can be written again", "missed": 3, "log_level": "info"}]
    assert log.head().missed == 0
    log.close()
    records = rig.said()
    assert kinds(records) == ["nothing", "capture", "gap", "capture", "capture", "stop"]
    assert records[2].entry.answers == 3  # type: ignore[union-attr]
    log = rig.open()
    for _ in range(2):  # told again when it fails again
        full.setattr(os, "pwrite", lambda *_: 5)
        append(log, 2)
        full.undo()
        append(log, 1)
    assert len(rig.faults) == 3


def test_disk_that_is_full_at_the_start_ends_nothing(rig: Rig, full: pytest.MonkeyPatch) -> None:
    log = rig.open()
    append(log, 2)
    assert [type(fault) for fault in rig.faults] == [StorageError]
    with pytest.raises(StorageError):
        log.head()
    with pytest.raises(StorageError):
        log.records(None, 1)
    full.undo()
    append(log, 1)
    log.close()
    records = rig.said()
    assert kinds(records) == ["nothing", "gap", "capture", "stop"]
    assert records[1].entry.answers == 2  # type: ignore[union-attr]


def test_segment_that_cannot_be_set_aside_is_tried_again(rig: Rig, monkeypatch: Any) -> None:
    rig.life(1)
    for path in rig.folder.iterdir():
        path.write_bytes(path.read_bytes() + b"{")

    def refuse(_: Path) -> None:
        raise FULL

    monkeypatch.setattr(segments_module, "make_directory", refuse)
    log = rig.open()
    append(log, 1)
    monkeypatch.undo()
    append(log, 1)
    log.close()
    assert kinds(rig.said()) == ["nothing", "capture", "stop", "damage", "gap", "capture", "stop"]


def test_full_disk_at_the_end_ends_nothing(rig: Rig, full: pytest.MonkeyPatch) -> None:
    full.undo()
    log = rig.open()
    append(log, 1)
    full.setattr(os, "pwrite", lambda *_: 5)
    log.close()
    log.close()
    full.undo()
    assert len(rig.faults) == 1
    assert kinds(rig.said()) == ["nothing", "capture"]


def test_nothing_is_written_after_the_stop(rig: Rig) -> None:
    log = rig.open()
    log.close()
    append(log, 1)
    log.close()
    assert kinds(rig.said()) == ["nothing", "stop"]


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_log_whose_writer_is_killed_has_every_answer_that_left(rig: Rig) -> None:
    # Whoever looks keeps as much as whoever writes: how much that is depends on the machine.
    limits = {"limit": 20_000, "kept": 10_000}

    def write(said: int) -> Iterator[int]:
        log = rig.open(**limits)
        for number in count(said):
            log.append(capture(number))
            yield number + 1

    def found(said: int) -> int:
        records = rig.said(**limits)
        numbers = [each.entry.number for each in records if each.entry.kind == "capture"]
        # What had left is there, and at most the answer that was cut off besides.
        assert set(range(said)) <= set(numbers) <= set(range(said + 1))
        starts = [each.entry.after for each in records if each.entry.kind == "start"]
        assert set(starts[1:]) <= {"cut", "damage", "stop"}
        return max(numbers, default=-1) + 1

    assert kill_writers(write, found) > 30
