"""A file is what it was or what was written, whatever fails, and nothing is left beside it."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Any

import pytest

from veilcam_optics.files import create_private, replacing, write_whole


def fail(*_: Any) -> None:
    raise OSError(28, "No space left on device")


def test_old_file_stands_until_the_new_one_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "file"
    write_whole(path, b"old")
    with replacing(path) as stream:
        stream.write(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert os.listdir(tmp_path) == ["file"]


@pytest.mark.parametrize("step", ["open", "fsync", "replace", "writer"])
def test_disk_that_refuses_and_writer_that_breaks_off_leave_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    path = tmp_path / "file"
    write_whole(path, b"old")
    if step == "writer":
        with pytest.raises(ValueError, match="closed"), replacing(path) as stream:
            stream.close()
    else:
        monkeypatch.setattr(os, step, fail)
        with pytest.raises(OSError, match="No space"):
            write_whole(path, b"new")
        monkeypatch.undo()
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["file"]


def test_all_is_on_the_disk_before_the_name_and_the_name_before_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []
    sync, move = os.fsync, os.replace

    def synced(handle: int) -> None:
        order.append("folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "file")
        sync(handle)

    def moved(source: Any, target: Any) -> None:
        order.append("name")
        move(source, target)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", moved)
    open_files = len(os.listdir("/proc/self/fd"))
    write_whole(tmp_path / "file", b"content")
    assert len(os.listdir("/proc/self/fd")) == open_files
    assert order == ["file", "name", "folder"]
    order.clear()
    create_private(tmp_path / "other", b"content")
    assert order == ["file", "folder"]


@pytest.mark.parametrize(("private", "mode"), [(True, 0o600), (False, 0o640)])
def test_file_is_readable_by_whom_it_should(tmp_path: Path, private: bool, mode: int) -> None:
    before = os.umask(0o027)
    try:
        write_whole(tmp_path / "file", b"", private=private)
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == mode


def test_created_file_was_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "secret"
    create_private(path, b"first")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    with pytest.raises(FileExistsError):
        create_private(path, b"second")
    assert path.read_bytes() == b"first"
    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="No space"):
        create_private(tmp_path / "other", b"")
    assert os.listdir(tmp_path) == ["secret"]
