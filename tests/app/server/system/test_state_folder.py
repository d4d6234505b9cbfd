"""State folder: what cannot be read is refused by name, and nothing in it is moved."""

from __future__ import annotations

import grp
import os
import pwd
import socket
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from veilcam_server.errors import StartError
from veilcam_server.system.state_file import HeldDirectory, make_directory
from veilcam_server.system.state_folder import become_owner, require_usable

FILES = (
    *("device-key.json", "tokens.json", "tokens.json.copy", "tokens.json.lock", "rotation.json"),
    "scene.npy",
    *(f"bundles/{'0f' * 32}.veilcam", "bundles/in-use.json", f"log/{0:020d}.jsonl"),
)
NOBODY = pwd.getpwnam("nobody")
GROUP = grp.getgrgid(NOBODY.pw_gid).gr_name
as_root = pytest.mark.skipif(os.geteuid() != 0, reason="gives files to another user: needs root")


def listen(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(os.path.relpath(path))  # a whole path may be too long


def filled(directory: Path) -> Path:
    for each in (directory, directory / "bundles", directory / "log"):
        make_directory(each)
    for name in FILES:
        (directory / name).write_text("kept")
    return directory


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    directory = filled(tmp_path / "state")
    monkeypatch.chdir(directory)
    return directory


def listing(folder: Path) -> list[tuple[str, int, int]]:
    paths = sorted(folder.rglob("*"))
    return [(str(path), path.lstat().st_mode, path.lstat().st_ino) for path in paths]


def test_folder_whose_files_can_be_read_is_usable(folder: Path) -> None:
    (folder / "lost+found").mkdir()
    (folder / "notes.txt").write_text("mine")
    listen(folder / "api")
    # A link to nothing is as if the file were gone.
    (folder / "tokens.json").unlink()
    (folder / "tokens.json").symlink_to("/nonexistent")
    before = listing(folder)
    require_usable(folder)
    require_usable(folder / "not-there-yet")
    assert listing(folder) == before


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize(
    ("make", "why"),
    [
        (Path.mkdir, "Is a directory"),
        (os.mkfifo, "Not a regular file"),
        (listen, "Not a regular file"),
        (lambda path: os.mknod(path, stat.S_IFCHR | 0o600, os.makedev(1, 5)), "Not a regular file"),
        (lambda path: path.symlink_to(path), "Too many levels of symbolic links"),
        (lambda path: path.symlink_to("/dev/null"), "Not a regular file"),
    ],
    ids=["folder", "fifo", "socket", "device", "loop", "link to a device"],
)
def test_path_that_is_no_file_is_refused_without_waiting(
    folder: Path, name: str, make: Callable[[Path], None], why: str
) -> None:
    (folder / name).unlink()
    try:
        make(folder / name)
    except PermissionError:
        pytest.skip("makes a device: needs root")
    before = listing(folder)
    for use in (require_usable, HeldDirectory):
        with pytest.raises(StartError) as caught:
            use(folder)
        assert str(caught.value) == f"{folder / name} cannot be read ({why}): move it away"
    assert listing(folder) == before


def test_fifo_of_any_name_is_refused(folder: Path) -> None:
    os.mkfifo(folder / "calibration.png")
    with pytest.raises(StartError, match=r"calibration\.png cannot be read"):
        require_usable(folder)


@pytest.mark.parametrize("name", ["bundles", "log"])
def test_file_in_the_place_of_a_folder_is_refused(folder: Path, name: str) -> None:
    (folder / name).rename(folder.with_name("elsewhere"))
    (folder / name).touch()
    with pytest.raises(StartError, match=rf"{name} cannot be read \(Not a directory\): move it"):
        require_usable(folder)


def hold_as_nobody(directory: Path) -> str:
    """Why another user cannot hold a state folder; nothing where it can."""
    told, tell = os.pipe()
    child = os.fork()
    if child == 0:
        said = "it ended otherwise"
        try:
            os.setgroups([])
            os.setgid(NOBODY.pw_gid)
            os.setuid(NOBODY.pw_uid)
            HeldDirectory(directory)
            said = ""
        except StartError as error:
            said = str(error)
        finally:
            os.write(tell, said.encode())
            os._exit(0)
    os.close(tell)
    os.waitpid(child, 0)
    with os.fdopen(told) as stream:
        return stream.read()


@as_root
@pytest.mark.parametrize("name", [*FILES, "bundles", "log"])
def test_file_of_another_owner_is_refused_with_owner_and_command(
    open_tmp_path: Path, name: str
) -> None:
    directory = filled(open_tmp_path / "state")
    for path in (directory, *directory.rglob("*")):
        os.chown(path, NOBODY.pw_uid, NOBODY.pw_gid)
    assert hold_as_nobody(directory) == ""
    os.chown(directory / name, 0, 0)
    (directory / name).chmod(0o600)
    before = listing(directory)
    assert hold_as_nobody(directory) == (
        f"{directory / name} cannot be read (Permission denied), it belongs to root: run 'sudo "
        f"chown -R nobody:{GROUP} {directory}'"
    )
    assert listing(directory) == before


@pytest.fixture
def open_tmp_path() -> Iterator[Path]:
    """One that other users get to."""
    with tempfile.TemporaryDirectory(prefix="veilcam-") as folder:
        Path(folder).chmod(0o711)
        yield Path(folder)


@as_root
def test_folder_of_another_user_is_refused_with_both_ways(open_tmp_path: Path) -> None:
    directory = open_tmp_path / "state"
    make_directory(directory)
    os.chown(directory, 1, 1)
    told = hold_as_nobody(directory)
    assert told == (
        f"{directory} cannot be used (Permission denied), it belongs to {pwd.getpwuid(1).pw_name}: "
        f"run it as that user, or 'sudo chown -R nobody:{GROUP} {directory}', or give "
        "another --state-dir"
    )


@as_root
def test_root_becomes_the_folder_s_owner_with_its_groups(open_tmp_path: Path) -> None:
    directory = open_tmp_path / "a" / "state"
    make_directory(directory)
    user = next(each for each in pwd.getpwall() if each.pw_uid != 0)
    os.chown(directory, user.pw_uid, user.pw_gid)
    os.chown(directory.parent, user.pw_uid, user.pw_gid)
    code = (
        "import os, sys; from pathlib import Path\n"
        "from veilcam_server.system.state_folder import become_owner\n"
        "become_owner(Path(sys.argv[1]))\n"
        "print(*os.getresuid(), *os.getresgid(), os.getgroups())"
    )
    for path in (directory, directory / "not" / "there"):
        done = subprocess.run(
            [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True
        )
        groups = sorted(os.getgrouplist(user.pw_name, user.pw_gid))
        ids = " ".join([str(user.pw_uid)] * 3 + [str(user.pw_gid)] * 3)
        assert done.stdout.strip() == f"{ids} {groups}"


@as_root
def test_command_of_root_makes_files_of_the_folder_s_owner(open_tmp_path: Path) -> None:
    directory = open_tmp_path / "state"
    make_directory(directory)
    os.chown(directory, NOBODY.pw_uid, NOBODY.pw_gid)
    veilcamd = (sys.executable, "-m", "veilcam_server")
    where = ("--state-dir", str(directory))
    for command in (
        ("token", "create", "--label", "x", "--scope", "read:status"),
        ("token", "list"),
    ):
        subprocess.run([*veilcamd, *command, *where], check=True, capture_output=True)
    found = {path.name: path.stat() for path in directory.rglob("*")}
    assert {"tokens.json", "device-key.json", "log"} <= set(found)
    assert {(each.st_uid, each.st_gid) for each in found.values()} == {
        (NOBODY.pw_uid, NOBODY.pw_gid)
    }


def test_user_that_is_no_root_or_owns_the_folder_stays_what_it_is(folder: Path) -> None:
    before = os.getresuid(), os.getresgid(), os.getgroups()
    become_owner(folder)
    assert (os.getresuid(), os.getresgid(), os.getgroups()) == before


@pytest.mark.parametrize("mode", [0o755, 0o777, 0o750, 0o701, 0o500])
@pytest.mark.parametrize("content", ["tokens.json", None])
def test_state_folder_is_its_owner_s_alone(tmp_path: Path, mode: int, content: str | None) -> None:
    directory = tmp_path / "state"
    directory.mkdir()
    if content is not None:
        (directory / content).touch()
    directory.chmod(mode)
    HeldDirectory(directory).close()
    assert stat.S_IMODE(directory.stat().st_mode) == 0o700


@pytest.mark.parametrize(("mode", "name"), [(0o755, "somebody"), (0o1777, "tokens.json")])
def test_folder_of_others_is_left_alone_and_refused(tmp_path: Path, mode: int, name: str) -> None:
    directory = tmp_path / "home"
    (directory / name).mkdir(parents=True)
    directory.chmod(mode)
    with pytest.raises(StartError, match=rf"home may be used by others \({mode:04o}\): give a f"):
        HeldDirectory(directory)
    assert stat.S_IMODE(directory.stat().st_mode) == mode


@pytest.mark.parametrize("umask", [0o000, 0o022, 0o077, 0o177])
def test_state_folder_is_private_whatever_the_umask(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        make_directory(tmp_path / "state")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "state").stat().st_mode) == 0o700
