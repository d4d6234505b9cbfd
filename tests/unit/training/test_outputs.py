"""A place that cannot be written to is refused before the work, and trying it leaves nothing."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import pytest

from veilcam_training.cli import fit as fit_command
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


@pytest.mark.parametrize(
    ("option", "name", "reason"),
    [
        ("--out", "a.zip", "use a name that ends in .veilcam"),
        ("--out", "none/a.veilcam", "make the folder none first"),
        ("--out", "file/a.veilcam", "make the folder file first"),
        ("--out", "folder.veilcam", "is a folder, use another name"),
        ("--out", "/proc/a.veilcam", "cannot be written to .*: use another place"),
        ("--out", f"{LONG}.veilcam", r"cannot be written to \(File name too long\)"),
        ("--work", "file", r"cannot be written to \(Not a directory\): use another place"),
        *(("--work", name, "cannot be written to") for name in ("file/inside", "link", "/proc/a")),
        ("--work", LONG, r"cannot be written to \(File name too long\)"),
    ],
)
def test_bad_places(folder: Path, option: str, name: str, reason: str) -> None:
    before = names(folder)
    check = partial(check_file, ending=".veilcam") if option == "--out" else check_folder
    with pytest.raises(TrainingError, match=f"{option} .*{reason}"):
        check(option, Path(name))
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


FIT, KEYRING = ("fit",), ("keyring",)


@pytest.mark.parametrize(
    "arguments",
    [
        *((*KEYRING, "--out", "folder.veilcam"), (*KEYRING, "--out", "/proc/a.veilcam")),
        (*KEYRING, "--out", "a.veilcam", "--work", "file"),
        *((*FIT, "--out", "/proc/a"), (*FIT, "--fresh", "--out", "file")),
        (*FIT, "--tensorboard", "file"),
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
        (cli, "fit_keyring"),
        (fit_command, "fit_bundle"),
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
