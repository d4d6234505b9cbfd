"""State files: what is damaged is noticed, put right from its copy, and told of."""

from __future__ import annotations

import errno
import fcntl
import io
import os
import stat
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from pydantic import BaseModel, ConfigDict
from structlog.testing import capture_logs
from tests.app.server.killing import kill_writers
from tests.unit.server.damage import DAMAGES, flip

from veilcam_server.errors import (
    ProblemError,
    StartError,
    StorageError,
)
from veilcam_server.system import state_file
from veilcam_server.system.state_file import HeldDirectory, StateStore, log_fault, make_directory


class Note(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")
    text: str = ""
    number: int = 0


class Rig:
    def __init__(self, folder: Path) -> None:
        self.path, self.copy = folder / "note.json", folder / "note.json.copy"
        self.faults: list[ProblemError] = []

    def open(self) -> StateStore[Note]:
        return StateStore(self.path, Note, lost="nothing is known", report=self.faults.append)

    def read(self) -> Note | None:
        return self.open().read()

    def write(self, *texts: str) -> None:
        for text in texts:
            self.open().change(lambda _, text=text: Note(text=text))  # type: ignore[misc]

    def codes(self) -> list[str]:
        return [fault.code for fault in self.faults]


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path)


@contextmanager
def full_disk(monkeypatch: pytest.MonkeyPatch, after: int = 0) -> Iterator[None]:
    """So many files more are flushed to the disk, and none after them."""
    left, flush = after, os.fsync

    def fsync(descriptor: int) -> None:
        nonlocal left
        if left == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        left -= 1
        flush(descriptor)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fsync)
        yield


def test_state_written_is_read(rig: Rig) -> None:
    assert rig.read() is None
    assert rig.open().change(lambda held: Note(text=repr(held))) == Note(text="None")
    assert rig.read() == Note(text="None")
    rig.open().change(lambda held: Note(text="b", number=0 if held is None else 7))
    assert rig.read() == Note(text="b", number=7)
    assert rig.path.read_bytes() == rig.copy.read_bytes()
    assert not rig.faults


def test_record_is_for_its_owner_alone_and_nothing_is_left_beside(rig: Rig) -> None:
    rig.write("a", "b")
    names = {path.name for path in rig.path.parent.iterdir()}
    assert names == {"note.json", "note.json.copy", "note.json.lock"}
    for name in names:
        assert stat.S_IMODE((rig.path.parent / name).stat().st_mode) == 0o600


@pytest.mark.parametrize("name", ["note.json", "note.json.copy"])
@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_one_damaged_copy_is_put_right_and_told_of(
    rig: Rig, damage: Callable[[Path], None], name: str
) -> None:
    rig.write("old", "new")
    damage(rig.path.with_name(name))
    assert rig.read() == Note(text="new")
    (fault,) = rig.faults
    assert isinstance(fault, ProblemError)
    what = "is gone" if damage is DAMAGES["removed"] else "is damaged"
    assert str(fault) == f"{name} {what}: its other copy is used, and it was put right"
    assert rig.path.read_bytes() == rig.copy.read_bytes()
    assert rig.path.with_name(f"{name}.damaged").exists() == (what == "is damaged")
    assert rig.read() == Note(text="new")
    assert len(rig.faults) == 1


@pytest.mark.parametrize("second", DAMAGES)
@pytest.mark.parametrize("first", DAMAGES)
def test_two_damaged_copies_are_lost_and_that_is_told(rig: Rig, first: str, second: str) -> None:
    rig.write("a", "b")
    DAMAGES[first](rig.path)
    DAMAGES[second](rig.copy)
    opened = rig.open()
    assert opened.read() is None
    (fault,) = rig.faults
    assert isinstance(fault, ProblemError)
    assert "note.json " in str(fault)
    assert "note.json.copy " in str(fault)
    assert "nothing is known" in str(fault)
    for name, kind in (("note.json", first), ("note.json.copy", second)):
        kept = rig.path.with_name(f"{name}.damaged")
        assert kept.exists() == (kind != "removed")
        assert (kept.name in str(fault)) == kept.exists()
    # It is told once by each daemon, until there is a record again.
    assert opened.read() is None
    assert rig.codes() == ["state_lost"]
    opened = rig.open()
    assert opened.read() is None
    assert rig.codes() == ["state_lost", "state_lost"]
    opened.change(lambda held: Note(text=repr(held)))
    assert opened.read() == rig.read() == Note(text="None")
    assert len(rig.faults) == 2


def test_damage_is_told_as_often_as_it_happens(rig: Rig) -> None:
    rig.write("a")
    opened = rig.open()
    for _ in range(2):
        flip(rig.path)
        assert opened.read() == opened.read() == Note(text="a")
    flip(rig.path)
    opened.change(lambda _: Note(text="b"))
    flip(rig.path)
    assert opened.read() == Note(text="b")
    assert rig.codes() == ["state_damaged"] * 4


def test_any_flipped_byte_is_noticed(rig: Rig) -> None:
    rig.write("abc")
    whole = rig.path.read_bytes()
    for place in range(len(whole)):
        spoilt = bytearray(whole)
        spoilt[place] ^= 1
        rig.path.write_bytes(spoilt)
        assert rig.read() == Note(text="abc")
        assert rig.path.read_bytes() == whole
    assert rig.codes() == ["state_damaged"] * len(whole)


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo, lambda path: path.symlink_to(path)])
@pytest.mark.parametrize("name", ["note.json", "note.json.copy"])
def test_file_that_cannot_be_read_is_not_damaged(
    rig: Rig, make: Callable[[Path], None], name: str
) -> None:
    rig.write("a")
    path = rig.path.with_name(name)
    kept = path.rename(path.with_name("kept"))
    make(path)
    before = sorted(rig.path.parent.iterdir())
    with pytest.raises(StorageError, match=rf"{name} cannot be read \(.*\): 'veilcamd doctor'"):
        rig.read()
    with pytest.raises(StorageError, match=r"directory|regular|symbolic"):
        rig.write("b")
    assert sorted(rig.path.parent.iterdir()) == before
    assert not rig.faults
    path.rmdir() if path.is_dir() else path.unlink()
    kept.rename(path)
    assert rig.read() == Note(text="a")


def test_disk_that_fails_is_not_damage(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    class Failing(io.BytesIO):
        def read(self, *_: object) -> bytes:
            raise OSError(errno.EIO, "Input/output error")

    rig.write("a")
    with monkeypatch.context() as patch:
        patch.setattr(os, "fdopen", lambda *_: Failing())
        with pytest.raises(StorageError, match=r"note\.json cannot be read \(Input/output error\)"):
            rig.read()
    assert rig.read() == Note(text="a")
    assert not rig.faults


def test_file_that_has_no_end_is_damaged(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig.write("a" * 100)
    monkeypatch.setattr(state_file, "MAX_BYTES", 100)
    assert rig.read() is None
    assert rig.codes() == ["state_lost"]


def test_newest_copy_counts_and_a_change_that_was_cut_off_is_no_fault(rig: Rig) -> None:
    rig.write("old")
    before = rig.path.read_bytes()
    rig.write("new")
    for path in (rig.path, rig.copy):
        path.write_bytes(before)
        assert rig.read() == Note(text="new")
        assert rig.path.read_bytes() == rig.copy.read_bytes() != before
    rig.write(*"cdefghi")  # as text, 10 comes before 9
    before = rig.copy.read_bytes()
    rig.write("j")
    rig.copy.write_bytes(before)
    assert rig.read() == Note(text="j")
    assert not rig.faults


def test_first_change_that_was_cut_off_is_no_fault(rig: Rig) -> None:
    rig.write("a")
    rig.path.unlink()
    os.truncate(rig.path.with_name("note.json.lock"), 0)
    assert rig.read() == Note(text="a")
    assert not rig.faults


def test_copy_of_the_record_alone_can_be_read(rig: Rig) -> None:
    rig.write("a")
    rig.copy.unlink()
    rig.path.with_name("note.json.lock").unlink()
    assert rig.read() == Note(text="a")
    assert not rig.copy.exists()
    assert not rig.faults


@pytest.mark.parametrize("after", [0, 1])
def test_full_disk_changes_nothing(rig: Rig, monkeypatch: pytest.MonkeyPatch, after: int) -> None:
    rig.write("a")
    with full_disk(monkeypatch, after), pytest.raises(StorageError, match="No space left"):
        rig.write("b")
    assert len(list(rig.path.parent.iterdir())) == 3
    assert rig.read() == Note(text="a")
    assert not rig.faults
    rig.write("b")
    assert rig.read() == Note(text="b")


def test_first_change_on_a_full_disk_leaves_no_record(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    with full_disk(monkeypatch), pytest.raises(StorageError, match="No space left"):
        rig.write("a")
    assert rig.read() is None
    assert not rig.faults


def test_everything_is_flushed_before_it_takes_its_place(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    fsync, replace = os.fsync, Path.replace

    def flushed(descriptor: int) -> None:
        done.append(f"flush {Path(os.readlink(f'/proc/self/fd/{descriptor}')).name}")
        fsync(descriptor)

    def renamed(path: Path, target: Path) -> Path:
        done.append(f"rename to {target.name}")
        return replace(path, target)

    monkeypatch.setattr(os, "fsync", flushed)
    monkeypatch.setattr(Path, "replace", renamed)
    rig.write("a")
    assert done == [
        "flush note.json.new",
        "flush note.json.copy.new",
        "rename to note.json.copy",
        "rename to note.json",
        f"flush {rig.path.parent.name}",
    ]


def test_disk_that_takes_nothing_is_read_all_the_same(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.write("a")
    flip(rig.path)
    with full_disk(monkeypatch):
        assert rig.read() == Note(text="a")
    assert str(rig.faults[0]).endswith("it cannot be put right now: check the disk")
    # It is put right as soon as it can be.
    assert rig.read() == Note(text="a")
    assert rig.codes() == ["state_damaged", "state_damaged"]
    assert rig.path.read_bytes() == rig.copy.read_bytes()


def test_damage_found_by_a_change_is_told_and_loses_nothing(rig: Rig) -> None:
    rig.write("a")
    opened = rig.open()
    flip(rig.path)
    changed = opened.change(lambda held: Note(text="b" if held is None else f"{held.text}b"))
    assert changed == Note(text="ab")
    assert rig.codes() == ["state_damaged"]
    assert rig.read() == Note(text="ab")


def test_staged_state_holds_once_it_is_committed(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig.write("a")
    with closing(rig.open().stage(lambda _: Note(text="b"))) as staged:
        assert staged.state == Note(text="b")
        assert rig.read() == Note(text="a")
        impatient = rig.open()
        impatient.patience = 0.0
        with pytest.raises(StorageError, match="another process keeps it"):
            impatient.change(lambda _: Note(text="c"))
        staged.commit()
        assert rig.read() == Note(text="b")
    with closing(rig.open().stage(lambda _: Note(text="c"))):
        pass
    assert rig.read() == Note(text="b")
    with full_disk(monkeypatch), pytest.raises(StorageError, match="No space left"):
        rig.open().stage(lambda _: Note(text="d"))
    rig.write("e")
    assert rig.read() == Note(text="e")
    assert len(list(rig.path.parent.iterdir())) == 3


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_writer_that_is_killed_loses_nothing_that_it_acknowledged(rig: Rig) -> None:
    def write(_: int) -> Iterator[int]:
        record = rig.open()
        while True:
            yield record.change(lambda held: Note(number=1 + (held.number if held else 0))).number

    def found(said: int) -> int:
        held = rig.read()
        number = 0 if held is None else held.number
        # What was acknowledged is there, and at most the change that was cut off besides.
        assert said <= number <= said + 1
        return number

    assert kill_writers(write, found) > 30
    assert not rig.faults


def test_file_of_another_record_is_damage(rig: Rig) -> None:
    class Other(BaseModel):
        more: int = 0

    other = StateStore(rig.path.with_name("other.json"), Other, lost="")
    for number in range(9):  # its serial number is the higher one
        other.change(lambda _, number=number: Other(more=number))  # type: ignore[misc]
    rig.write("a")
    content = rig.path.with_name("other.json").read_bytes()
    for path in (rig.path, rig.copy):
        path.write_bytes(content)
        assert rig.read() == Note(text="a")
        assert path.with_name(f"{path.name}.damaged").read_bytes() == content
    assert str(rig.faults[0]).startswith("note.json holds another record: its other copy is used")
    for path in (rig.path, rig.copy):
        path.write_bytes(content)
    assert rig.read() is None
    assert rig.codes() == ["state_damaged", "state_damaged", "state_lost"]


def test_version_tells_a_change(rig: Rig) -> None:
    seen = rig.open()
    versions = [seen.version]
    for text in ("a", "b", "c"):
        rig.write(text)
        versions.append(seen.version)
        assert seen.version == versions[-1]
    assert versions[0] is None
    assert len(set(versions)) == 4


def test_changes_of_several_threads_are_all_kept(rig: Rig) -> None:
    def count(held: Note | None) -> Note:
        return Note(number=1 if held is None else held.number + 1)

    def work(_: int) -> None:
        for _ in range(10):
            rig.open().change(count)

    with ThreadPoolExecutor(4) as threads:
        list(threads.map(work, range(4)))
    assert rig.read() == Note(number=40)


@contextmanager
def locked(rig: Rig) -> Iterator[None]:
    """As by another process."""
    with rig.path.with_name("note.json.lock").open("rb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def test_change_waits_for_another_but_not_for_ever(rig: Rig) -> None:
    rig.write("a")
    opened = rig.open()
    assert opened.patience == 5.0
    opened.patience = 0.02
    with locked(rig), pytest.raises(StorageError, match="another process keeps it"):
        opened.change(lambda _: Note(text="b"))
    opened.patience = 60.0
    with locked(rig):
        waiting = threading.Thread(target=opened.change, args=(lambda _: Note(text="c"),))
        waiting.start()
        waiting.join(0.05)
        assert waiting.is_alive()
        assert rig.read() == Note(text="a")
    waiting.join()
    assert rig.read() == Note(text="c")


def test_record_that_is_being_changed_is_read_without_waiting(rig: Rig) -> None:
    rig.write("a")
    before = rig.path.read_bytes()
    rig.write("b")
    rig.path.write_bytes(before)  # the copy has its place already, the record has not
    with locked(rig):
        assert rig.read() == Note(text="b")
        assert rig.path.read_bytes() == before
    assert not rig.faults


def test_faults_are_logged_where_nobody_takes_them(rig: Rig) -> None:
    with capture_logs() as logs:
        log_fault(ProblemError("state_lost", "gone"))
    entry = {"event": "fault", "log_level": "warning", "remedy": "check_disk"}
    assert logs == [{**entry, "code": "state_lost", "detail": "gone"}]


def test_directory_is_made_and_held_by_one(tmp_path: Path) -> None:
    directory = tmp_path / "var" / "state"
    held = HeldDirectory(directory)
    with closing(held):
        assert stat.S_IMODE(directory.stat().st_mode) == 0o700
        with pytest.raises(StartError, match=r"another veilcamd uses .*state: stop it, or give"):
            HeldDirectory(directory)
    held.close()
    with closing(HeldDirectory(directory)):
        assert not list(directory.iterdir())


def test_directory_that_is_made_is_durable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flushed: list[str] = []
    monkeypatch.setattr(state_file, "sync_folder", lambda folder: flushed.append(folder.name))
    for _ in range(2):
        make_directory(tmp_path / "var" / "state")
    assert flushed == ["var"]
    assert stat.S_IMODE((tmp_path / "var" / "state").stat().st_mode) == 0o700


def test_path_that_is_no_directory_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(StartError, match=r"cannot be used \(.*\): move it away, or give an"):
            HeldDirectory(path)
