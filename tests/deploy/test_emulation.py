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


def test_without_an_emulator_it_says_what_to_install(binfmt: Path, tmp_path: Path) -> None:
    with pytest.raises(EmulationError, match=r"apt install qemu-user-static$"):
        register("arm64", binfmt, tmp_path)


def test_a_kernel_without_it_is_named(tmp_path: Path, rules: Path) -> None:
    with pytest.raises(EmulationError, match="cannot be mounted"):
        register("arm64", tmp_path / "nowhere", rules)


def test_a_refusal_is_told(binfmt: Path, rules: Path) -> None:
    (binfmt / "register").unlink()
    (binfmt / "register").mkdir()
    with pytest.raises(EmulationError, match="Linux refuses the entry"):
        register("arm64", binfmt, rules)
