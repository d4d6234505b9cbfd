"""The entry in binfmt_misc, in folders that stand for Linux's and the emulator's."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.system.debian_package.emulation import EmulationError, register

RULE = ":qemu-aarch64:M::magic:mask:/usr/libexec/qemu-binfmt/aarch64-binfmt-P:OPF"


@pytest.fixture
def rules(tmp_path: Path) -> Path:
    """As the emulator's package leaves it."""
    folder = tmp_path / "rules"
    folder.mkdir()
    (folder / "qemu-aarch64.conf").write_text(f"{RULE}\n")
    return folder


@pytest.fixture
def binfmt(tmp_path: Path) -> Path:
    """As Linux mounts it, without an entry."""
    folder = tmp_path / "binfmt"
    folder.mkdir()
    (folder / "register").touch()
    return folder


def test_the_rule_is_handed_to_linux(binfmt: Path, rules: Path) -> None:
    register("arm64", binfmt, rules)
    assert (binfmt / "register").read_text() == RULE


def test_an_entry_that_is_there_is_left(binfmt: Path, rules: Path) -> None:
    (binfmt / "qemu-aarch64").touch()
    register("arm64", binfmt, rules)
    assert (binfmt / "register").read_text() == ""


def test_what_keeps_it_from_being_entered_is_told(
    binfmt: Path, rules: Path, tmp_path: Path
) -> None:
    (binfmt / "register").unlink()
    (binfmt / "register").mkdir()
    for place, given, told in (
        (binfmt, tmp_path, r"apt install qemu-user-static$"),
        (tmp_path / "nowhere", rules, "cannot be mounted"),
        (binfmt, rules, "Linux refuses the entry"),
    ):
        with pytest.raises(EmulationError, match=told):
            register("arm64", place, given)
