"""A private file is its owner's alone, whole or refused, and leaves nothing beside it."""

from __future__ import annotations

import os
import random
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from veilcam_training.errors import TrainingError
from veilcam_training.files import read_private, write_private
from veilcam_training.trainer.loop import load_checkpoint, save_checkpoint

STATE: dict[str, Any] = {
    "model": {"weight": torch.arange(40.0)},
    "history": [{"number": 0, "loss": 0.5}],
}


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_private_file_is_its_owner_s_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path, seen = tmp_path / "work" / "fit.checkpoint", []
    monkeypatch.setattr(os, "fsync", lambda handle: seen.append(os.fstat(handle).st_mode))
    save_checkpoint(path, "a", STATE)
    assert mode(path) == 0o600
    assert mode(path.parent) == 0o700
    temporary, folder = seen  # both reach the disk
    assert stat.S_IMODE(temporary) == 0o600
    assert stat.S_ISDIR(folder)
    # One that others could read is replaced by one that they cannot.
    path.chmod(0o644)
    save_checkpoint(path, "a", STATE)
    assert mode(path) == 0o600


def test_leftovers_of_dead_writers_are_removed(tmp_path: Path) -> None:
    path = tmp_path / "fit.checkpoint"
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    left = [tmp_path / f".{path.name}.{number}.00c0ffee" for number in (dead.pid, os.getpid())]
    others = [
        tmp_path / f".{path.name}.{os.getppid()}.00c0ffee",  # it is being written
        tmp_path / f".other.checkpoint.{dead.pid}.00c0ffee",
        tmp_path / f".{path.name}.old",
    ]
    for file in (*left, *others):
        file.touch()
    write_private(path, b"content")
    assert sorted(tmp_path.iterdir()) == sorted([path, *others])


def test_every_damage_is_found(tmp_path: Path) -> None:
    path = tmp_path / "fit.checkpoint"
    save_checkpoint(path, "a", STATE)
    saved = load_checkpoint(path, "a")
    assert saved is not None
    assert torch.equal(saved["model"]["weight"], STATE["model"]["weight"])
    whole, places = path.read_bytes(), random.Random(0)
    for _ in range(200):
        place = places.randrange(len(whole))
        flipped = bytearray(whole)
        flipped[place] ^= 1 << places.randrange(8)
        for damaged in (bytes(flipped), whole[:place], whole + whole[place:]):
            path.write_bytes(damaged)
            with pytest.raises(TrainingError, match=r"cannot be read \(damaged.*: remove it to"):
                load_checkpoint(path, "a")


def test_whole_but_not_for_this_torch(tmp_path: Path) -> None:
    path = tmp_path / "fit.checkpoint"
    for content in (b"what it may write one day", b"PK\x03\x04 of a kind"):
        write_private(path, content)
        with pytest.raises(TrainingError, match=r"version of torch\): remove it") as caught:
            load_checkpoint(path, "a")
        assert "\n" not in str(caught.value)
        assert read_private(path) == content
    write_private(path, b"")
    assert read_private(path) == b""
    path.unlink()
    assert read_private(path) is None
    with pytest.raises(TrainingError, match=r"cannot be read \(Is a directory\): remove it"):
        read_private(tmp_path)
