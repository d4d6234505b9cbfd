"""Segments: lines whole or not at all, their bound, and what is found of them afterwards."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from veilcam_client.keys.capture_log import line_digest
from veilcam_server.sealing import segments as module
from veilcam_server.sealing.segments import Ending, Segments, lines_of

FULL = OSError(errno.ENOSPC, "No space left on device")


def chain(count: int) -> list[bytes]:
    """Lines that follow from each other."""
    lines: list[bytes] = []
    for position in range(count):
        previous = line_digest(lines[-1]) if lines else "0" * 64
        start = f'{{"version":1,"device":"{"d7" * 32}","position":{position},'
        lines.append(f'{start}"previous":"{previous}","entry":"{position:030d}"}}'.encode())
    return lines


LINES = chain(12)
ROOM = 3 * (len(LINES[0]) + 1)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "log"


def genuine(line: bytes) -> bool:
    return line in LINES


def written(folder: Path, count: int = 8, **limits: int) -> Segments:
    segments = Segments(folder, **{"limit": ROOM, **limits})
    for position, line in enumerate(LINES[:count]):
        segments.append(position, line)
    return segments


def content(segments: Segments, position: int = 0) -> list[bytes]:
    """All lines from the file that has a position."""
    return [
        line
        for path, size in segments.files(position)
        for line in lines_of(path.read_bytes()[:size])
    ]


def recovered(folder: Path) -> tuple[Ending, Segments]:
    segments = Segments(folder, limit=ROOM)
    return segments.recover(genuine), segments


def test_lines_are_in_files_that_are_named_by_their_first(folder: Path) -> None:
    with closing(written(folder)) as segments:
        assert content(segments) == LINES[:8]
        assert content(segments, 3) == content(segments, 5) == LINES[3:8]
        assert content(segments, 99) == LINES[6:8]
    names = sorted(path.name for path in folder.iterdir())
    assert names == [f"{first:020d}.jsonl" for first in (0, 3, 6)]
    assert {path.stat().st_mode & 0o777 for path in folder.iterdir()} == {0o600}
    assert folder.stat().st_mode & 0o777 == 0o700


def test_nothing_is_there_before_the_first_line(folder: Path) -> None:
    ending, segments = recovered(folder)
    assert ending == Ending(None, torn=False, breaks=0)
    assert segments.files(0) == []
    assert segments.flushable() is None
    assert (segments.oldest, segments.surplus) == (0, 0)
    assert not folder.exists()
    segments.close()


def test_log_goes_on_where_it_ended(folder: Path) -> None:
    written(folder).close()
    (folder / "notes.txt").write_text("none of its business")
    ending, segments = recovered(folder)
    assert ending == Ending(LINES[7], torn=False, breaks=0)
    with closing(segments):
        for position in (8, 9):
            segments.append(position, LINES[position])
        assert content(segments) == LINES[:10]
    assert not segments.aside.exists()


def test_oldest_make_room_once_that_is_said(folder: Path) -> None:
    with closing(written(folder, 7, kept=2)) as segments:
        assert (segments.oldest, segments.surplus) == (0, 3)
        segments.drop()
        assert (segments.oldest, segments.surplus) == (3, 0)
        assert content(segments) == LINES[3:7]
        segments.drop()
    assert len(list(folder.iterdir())) == 2


def test_segment_that_cannot_be_removed_stops_nothing(folder: Path) -> None:
    with closing(written(folder, 7, kept=2)) as segments:
        (folder / f"{0:020d}.jsonl").unlink()
        segments.drop()
        assert segments.oldest == 3


@pytest.mark.parametrize(
    ("damage", "last"),
    [
        (lambda held: held[:-1], 6),
        (lambda held: held[:-40], 6),
        (lambda held: held + b"{", 7),
        (lambda held: held + bytes(200), 7),
        (lambda held: held + LINES[11][:50], 7),
        (lambda held: held.replace(b'"position":7', b'"position":8'), 6),
        (lambda held: b"\n" + held[1:], 7),
        (lambda _: b"", 5),
        (lambda _: b"\n\n\xff", 5),
    ],
)
def test_damaged_end_is_set_aside(
    folder: Path, damage: Callable[[bytes], bytes], last: int
) -> None:
    written(folder).close()
    newest = folder / f"{6:020d}.jsonl"
    held = newest.read_bytes()
    newest.write_bytes(damage(held))
    ending, segments = recovered(folder)
    with closing(segments):
        assert ending.last == LINES[last]
        assert ending.torn == (last < 7 or damage(held).startswith(held))
        if ending.torn:
            [aside] = segments.aside.iterdir()
            assert aside.name == newest.name
            assert damage(held).endswith(aside.read_bytes())
        segments.append(last + 1, LINES[last + 1])
        assert content(segments)[-1] == LINES[last + 1]
        assert newest.exists()


def test_segments_set_aside_before_make_room(folder: Path) -> None:
    for _ in range(2):
        written(folder).close()
        for path in folder.iterdir():
            path.write_bytes(b"x")
        ending, segments = recovered(folder)
        assert ending == Ending(None, torn=True, breaks=0)
        assert len(list(segments.aside.iterdir())) == 3
        assert not list(folder.iterdir())


@pytest.mark.parametrize(
    ("damage", "breaks"),
    [
        (lambda held: held.replace(b"0004", b"0005"), 1),
        (lambda held: held.replace(LINES[4], b""), 1),
        (lambda held: held.replace(LINES[4] + b"\n", b""), 1),
        (lambda _: b"", 1),
        (lambda held: held.replace(LINES[3] + b"\n" + LINES[4], LINES[4] + b"\n" + LINES[3]), 3),
    ],
)
def test_damage_before_the_end_is_counted_and_left_as_it_is(
    folder: Path, damage: Callable[[bytes], bytes], breaks: int
) -> None:
    written(folder).close()
    middle = folder / f"{3:020d}.jsonl"
    damaged = damage(middle.read_bytes())
    middle.write_bytes(damaged)
    ending, segments = recovered(folder)
    segments.close()
    assert ending == Ending(LINES[7], torn=False, breaks=breaks)
    assert middle.read_bytes() == damaged


def test_file_that_is_gone_is_a_break_and_one_that_cannot_be_read_stays(folder: Path) -> None:
    written(folder).close()
    middle = folder / f"{3:020d}.jsonl"
    middle.unlink()
    ending, segments = recovered(folder)
    assert ending == Ending(LINES[7], torn=False, breaks=1)
    segments.close()
    for unreadable in (middle, sorted(folder.iterdir())[-1]):
        unreadable.unlink(missing_ok=True)
        os.mkfifo(unreadable)
        with pytest.raises(OSError, match="Not a regular file"):
            recovered(folder)
        assert unreadable.is_fifo()
        assert not (folder.with_name("log.damaged")).exists()


@pytest.mark.parametrize("count", [0, 2, 3])
@pytest.mark.parametrize("half", [True, False])
def test_full_disk_leaves_neither_half_a_line_nor_an_empty_file(
    folder: Path, monkeypatch: pytest.MonkeyPatch, count: int, half: bool
) -> None:
    def pwrite(file: int, data: bytes, place: int) -> int:
        if not half:
            raise FULL
        return real(file, data[:9], place)

    segments, real = written(folder, count), os.pwrite
    monkeypatch.setattr(os, "pwrite", pwrite)
    for _ in range(2):
        with pytest.raises(OSError, match="No space"):
            segments.append(count, LINES[count])
        held = sorted(folder.iterdir())
        assert b"".join(path.read_bytes() for path in held) == b"".join(
            line + b"\n" for line in LINES[:count]
        )
        assert all(path.stat().st_size for path in held)
        assert len(segments.files(0)) == len(held)
    monkeypatch.undo()
    segments.append(count, LINES[count])
    assert content(segments) == LINES[: count + 1]
    segments.close()


def test_half_a_line_that_cannot_be_undone_is_written_over(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    segments, real = written(folder, 1), os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda file, data, at: real(file, data[:9], at))
    monkeypatch.setattr(os, "ftruncate", lambda *_: (_ for _ in ()).throw(FULL))
    with pytest.raises(OSError, match="No space"):
        segments.append(1, LINES[1])
    monkeypatch.undo()
    assert content(segments) == LINES[:1]  # half a line counts for nobody who looks
    segments.append(1, LINES[1])
    assert content(segments) == LINES[:2]
    segments.close()


def test_file_that_somebody_removes_is_begun_anew(folder: Path) -> None:
    segments = written(folder, 2)
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()
    segments.append(2, LINES[2])
    segments.close()
    assert (folder / f"{2:020d}.jsonl").read_bytes() == LINES[2] + b"\n"


def test_file_is_on_the_disk_before_the_next_begins(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed: list[int] = []
    monkeypatch.setattr(os, "fsync", lambda file: flushed.append(os.fstat(file).st_size))
    monkeypatch.setattr(module, "sync_folder", lambda _: flushed.append(-1))
    folder.mkdir()
    written(folder, 4).close()
    assert flushed == [-1, ROOM, -1]
