"""Backups: a state folder moved to another card, and wiped at the end."""

from __future__ import annotations

import io
import stat
import tarfile
from collections.abc import Callable
from contextlib import closing
from hashlib import sha256
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.rotation import EverySeconds
from veilcam_client.wire.tokens import SCOPES
from veilcam_server.cli.main import app
from veilcam_server.system.state_file import HeldDirectory
from veilcam_server.testing import FakeCamera

SET = EverySeconds(seconds=9.0)


def run(command: str, *arguments: object, state: Path) -> Result:
    words = [command, *map(str, arguments), "--state-dir", str(state)]
    return CliRunner().invoke(app, words)


def contents(folder: Path) -> dict[str, bytes]:
    paths = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


@pytest.fixture
def state(tmp_path: Path) -> Path:
    """Folder with a record, a folder and what is no state."""
    folder = tmp_path / "state"
    made = run("token", "create", "--label", "a", "--scope", "classify", state=folder)
    assert made.exit_code == 0, made.output
    (folder / "bundles").mkdir()
    (folder / "bundles" / f"{'0f' * 32}.veilcam").write_bytes(b"masks" * 999)
    (folder / "device-key.json.damaged").write_bytes(b"seed")
    return folder


@pytest.fixture
def saved(state: Path, tmp_path: Path) -> Path:
    done = run("backup", tmp_path / "saved", state=state)
    assert done.exit_code == 0, done.output
    return tmp_path / "saved"


def sealed(content: bytes) -> bytes:
    return content + sha256(content).digest()


def archive(*names: str, kind: bytes = tarfile.REGTYPE) -> bytes:
    made = io.BytesIO()
    with tarfile.open(fileobj=made, mode="w") as tar:
        for name in names:
            member = tarfile.TarInfo(name)
            member.type, member.linkname = kind, "/etc/passwd"
            member.size = 3 if kind == tarfile.REGTYPE else 0
            tar.addfile(member, io.BytesIO(b"abc"))
    return sealed(made.getvalue())


def test_state_of_a_daemon_goes_on_from_another_card(tmp_path: Path) -> None:
    old, new, file = tmp_path / "old", tmp_path / "new", tmp_path / "saved"
    settings = {"state_dir": old, "auth": "tokens"}
    with FakeCamera(settings) as fake, fake.camera(token=(token := fake.token(SCOPES))) as camera:
        camera.receivers.add("archive", ReceiverKey.generate().public)
        camera.rotation.set(SET)
        camera.classify()
        before = (
            camera.status().device.key,
            camera.receivers.list(),
            [each.id for each in camera.tokens.list(limit=2).tokens],
        )
        refused = run("backup", file, state=old)
        assert refused.exit_code == 1
        assert "another veilcamd uses" in refused.stderr
        assert not file.exists()
    kept = contents(old)
    done = run("backup", file, state=old)
    assert done.exit_code == 0, done.output
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    done = run("restore", file, state=new)
    assert done.exit_code == 0, done.output
    assert contents(new) == kept
    assert stat.S_IMODE(new.stat().st_mode) == 0o700
    assert {stat.S_IMODE((new / name).stat().st_mode) for name in kept} == {0o600}
    with FakeCamera({**settings, "state_dir": new}) as fake, fake.camera(token=token) as camera:
        after = (
            camera.status().device.key,
            camera.receivers.list(),
            [each.id for each in camera.tokens.list(limit=2).tokens],
        )
        assert after == before
        assert camera.rotation.get().policy == SET
        assert not camera.diagnostics().faults


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content[:-1],
        lambda content: content[: len(content) // 2],
        lambda content: content[:9] + bytes([content[9] ^ 1]) + content[10:],
        lambda content: content[:-1] + bytes([content[-1] ^ 1]),
        lambda content: content + b"x",
        lambda _: b"",
        lambda _: b"no backup at all",
        lambda _: sealed(b"no archive"),
        lambda _: archive("../escaped"),
        lambda _: archive("/escaped"),
        lambda _: archive("bundles/../../escaped"),
        lambda _: archive("bundles/.."),
        lambda _: archive("tokens.json/../../escaped"),
        lambda _: archive("other.txt"),
        lambda _: archive("tokens.json\n"),
        lambda _: archive("tokens.json", "tokens.json"),
        lambda _: archive("tokens.json", kind=tarfile.SYMTYPE),
        lambda _: archive("tokens.json", kind=tarfile.LNKTYPE),
        lambda _: archive("bundles", kind=tarfile.DIRTYPE),
        lambda _: archive("tokens.json", kind=tarfile.FIFOTYPE),
    ],
)
def test_damaged_backup_is_refused_with_nothing_written(
    saved: Path, tmp_path: Path, damage: Callable[[bytes], bytes]
) -> None:
    saved.write_bytes(damage(saved.read_bytes()))
    before = contents(tmp_path)
    result = run("restore", saved, state=tmp_path / "new")
    assert result.exit_code == 1
    assert "nothing was written" in result.stderr
    assert contents(tmp_path) == before
    assert not (tmp_path / "new").exists()


def test_folder_with_anything_in_it_is_not_restored_into(saved: Path, tmp_path: Path) -> None:
    folder = tmp_path / "new"
    folder.mkdir()
    (folder / "notes").write_text("mine")
    folder.chmod(0o700)
    result = run("restore", saved, state=folder)
    assert result.exit_code == 1
    assert "is not empty: move what is in it away" in result.stderr
    assert contents(folder) == {"notes": b"mine"}
    (folder / "notes").unlink()
    # As a restore that lost its power left it.
    (folder / ".restoring").mkdir()
    (folder / ".restoring" / "tokens.json").write_text("half")
    assert run("restore", saved, state=folder).exit_code == 0
    assert contents(folder) == contents(tmp_path / "state")


@pytest.mark.parametrize("command", ["backup", "restore", "wipe"])
def test_folder_that_a_daemon_uses_is_left_alone(
    saved: Path, state: Path, tmp_path: Path, command: str
) -> None:
    folder = tmp_path / "new" if command == "restore" else state
    argument = {"backup": tmp_path / "more", "restore": saved, "wipe": "--yes"}[command]
    with closing(HeldDirectory(folder)):
        before = contents(tmp_path)
        result = run(command, argument, state=folder)
        assert result.exit_code == 1
        assert "another veilcamd uses" in result.stderr
        assert contents(tmp_path) == before


def test_backup_overwrites_nothing_and_is_not_within_the_state(saved: Path, state: Path) -> None:
    before = saved.read_bytes()
    assert "give the name of a new file" in run("backup", saved, state=state).stderr
    assert saved.read_bytes() == before
    assert "within the state directory" in run("backup", state / "me", state=state).stderr
    assert not (state / "me").exists()
    assert "holds no state" in run("backup", state.parent / "none", state=state / "no").stderr
    assert not (state.parent / "none").exists()
    assert not (state / "no").exists()


def test_backup_on_a_full_disk_leaves_nothing(state: Path, tmp_path: Path) -> None:
    assert "cannot be written" in run("backup", "/dev/full", state=state).stderr
    assert "cannot be written" in run("backup", tmp_path / "no" / "saved", state=state).stderr


def test_wipe_overwrites_before_it_removes(state: Path, tmp_path: Path) -> None:
    (state / "notes.txt").write_text("mine")
    asked = CliRunner().invoke(app, ["wipe", "--state-dir", str(state)], input="n\n")
    assert asked.exit_code == 1
    assert "nothing was changed" in asked.stderr
    links: dict[Path, Path] = {}
    for path in list(state.rglob("*")):  # other names of the same blocks
        if path.is_file() and path.name != "notes.txt":
            links[path] = tmp_path / f"link-{len(links)}"
            links[path].hardlink_to(path)
    before = {link: link.read_bytes() for link in links.values()}
    done = run("wipe", "--yes", state=state)
    assert done.exit_code == 0, done.output
    assert contents(state) == {"notes.txt": b"mine"}
    assert "left: notes.txt" in done.stdout
    for link, content in before.items():
        found = link.read_bytes()
        assert len(found) == len(content)
        assert found != content or not content
    assert len([content for content in before.values() if content]) >= 5
    assert "holds no state" in run("wipe", "--yes", state=state).stderr
