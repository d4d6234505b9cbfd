"""A place that cannot be written to is refused before the work, and trying it leaves nothing."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from veilcam_training.cli import fresh as fresh_command
from veilcam_training.cli import main as cli
from veilcam_training.data import download
from veilcam_training.errors import TrainingError
from veilcam_training.files import check_file, check_folder

LONG = "a" * 300


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Stands in a folder that has a file, a folder and a link to nothing, all of them bad."""
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "file").touch()
    (folder / "folder.veilcam").mkdir()
    (folder / "link").symlink_to("nothing")
    monkeypatch.chdir(folder)
    return folder


def names(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


BAD_FILES = [
    ("a.zip", "use a name that ends in .veilcam"),
    ("none/a.veilcam", "make the folder none first"),
    ("file/a.veilcam", "make the folder file first"),
    ("folder.veilcam", "is a folder, use another name"),
    ("/proc/a.veilcam", "cannot be written to .*: use another place"),
    (f"{LONG}.veilcam", r"cannot be written to \(File name too long\)"),
]
BAD_FOLDERS = [
    ("file", r"cannot be written to \(Not a directory\): use another place"),
    ("file/inside", "cannot be written to"),
    ("link", "cannot be written to"),
    ("/proc/a", "cannot be written to"),
    (LONG, r"cannot be written to \(File name too long\)"),
]


@pytest.mark.parametrize(("name", "reason"), BAD_FILES)
def test_bad_files(folder: Path, name: str, reason: str) -> None:
    before = names(folder)
    with pytest.raises(TrainingError, match=f"--out .*{reason}"):
        check_file("--out", Path(name), ".veilcam")
    assert names(folder) == before


@pytest.mark.parametrize(("name", "reason"), BAD_FOLDERS)
def test_bad_folders(folder: Path, name: str, reason: str) -> None:
    before = names(folder)
    with pytest.raises(TrainingError, match=f"--work .*{reason}"):
        check_folder("--work", Path(name))
    assert names(folder) == before


def test_good_places(folder: Path) -> None:
    (folder / "old.veilcam").write_text("old")
    before = names(folder)
    for name in ("new.veilcam", "old.veilcam", "folder.veilcam/a.veilcam", "../a.veilcam"):
        check_file("--out", Path(name), ".veilcam")
    for name in ("new", "folder.veilcam", "folder.veilcam/a/b", "new/../../other", "."):
        check_folder("--work", Path(name))
    assert names(folder) == before
    assert names(folder.parent) == [folder.name, *(f"{folder.name}/{name}" for name in before)]
    assert (folder / "old.veilcam").read_text() == "old"


FIT, KEYRING, FRESH = ("fit",), ("keyring",), ("fit-fresh", "--masks", "5", "--epochs", "1")


@pytest.mark.parametrize(
    "arguments",
    [
        (*FIT, "--out", "folder.veilcam"),
        (*FIT, "--out", "/proc/a.veilcam"),
        (*FIT, "--work", "/proc/a"),
        (*FIT, "--work", "file"),
        (*FIT, "--tensorboard", "file"),
        (*FIT, "--csv", "/proc/a.csv"),
        (*KEYRING, "--out", "/proc/a.veilcam"),
        (*KEYRING, "--out", "a.veilcam", "--work", "file"),
        (*FRESH, "--out", "folder.veilcam"),
        (*FRESH, "--out", "/proc/a.veilcam"),
        (*FRESH, "--out", "a.veilcam", "--work", "file"),
        ("download", "mnist"),
    ],
    ids=" ".join,
)
def test_commands_try_their_places_first(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    folder: Path,
    digit_folder: Path,
    arguments: tuple[str, ...],
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError

    for module, name in (
        (cli, "run_fit"),
        (cli, "fit_keyring"),
        (fresh_command, "run_fresh"),
        (download, "_fetch"),
    ):
        monkeypatch.setattr(module, name, refuse)
    before = names(folder)
    data = "file" if arguments[0] == "download" else str(digit_folder)
    monkeypatch.setattr(sys, "argv", ["veilcam-train", *arguments, "--data", data])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert caught.value.code == 1
    errors = capsys.readouterr().err
    assert errors.startswith("error: --")
    assert "use another" in errors
    assert errors.count("\n") == 1
    assert names(folder) == before
