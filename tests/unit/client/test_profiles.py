"""The camera that the arguments of the SDK, the environment and the profiles mean."""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from veilcam_client import AsyncCamera, Camera, VeilcamError
from veilcam_client.errors import ArgumentError, FileError
from veilcam_client.http.options import DEFAULT_URL
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.profiles import Profile, new_profile, profile_of, profiles_path

HALL, DESK = "https://hall:8787", "unix:///run/desk.sock"
FILE = f"""# mine
default = "hall"
[profiles.hall]
url = "{HALL}"
token_file = "hall.token"
ca_file = "/etc/hall.pem"
certificate = "{"ab" * 32}"
key = "hall.key"
device = "{"cd" * 32}"

[profiles.desk]
url = "{DESK}"
"""
MADE = Profile("https://attic:1", "vc_attic", certificate="ab" * 32, device="ef" * 32)


@pytest.fixture
def folder(settings: Path) -> Path:
    settings.mkdir(parents=True)
    (settings / "hall.token").write_text("vc_hall\n")
    (settings / "hall.token").chmod(0o600)
    (settings / "config.toml").write_text(FILE)
    return settings


def add(key: ReceiverKey, wanted: str = "attic", made: Profile = MADE) -> tuple[str, bool]:
    with new_profile(wanted, key, exact=False) as (name, save):
        return name, save(made)


@pytest.mark.parametrize(
    ("arguments", "variables", "found"),
    [
        ({}, {}, (HALL, "vc_hall")),
        ({"profile": "desk"}, {}, (DESK, None)),
        ({}, {"PROFILE": "desk"}, (DESK, None)),
        ({"profile": "hall"}, {"PROFILE": "desk"}, (HALL, "vc_hall")),
        ({}, {"PROFILE": "desk", "URL": "http://127.0.0.1:1"}, (DESK, None)),
        ({}, {"PROFILE": "desk", "TOKEN": "vc_mine"}, (DESK, None)),
        ({}, {"URL": "http://127.0.0.1:1"}, ("http://127.0.0.1:1", None)),
        ({}, {"URL": "http://[::1]", "TOKEN": "vc_mine"}, ("http://[::1]", "vc_mine")),
        # A token of the environment is for a camera of the environment.
        ({}, {"TOKEN": "vc_mine"}, (HALL, "vc_hall")),
        ({"url": DEFAULT_URL}, {"PROFILE": "desk"}, (DEFAULT_URL, None)),
        ({"url": DEFAULT_URL}, {"TOKEN": "vc_mine"}, (DEFAULT_URL, "vc_mine")),
        ({"token": "vc_other"}, {}, (HALL, "vc_other")),
    ],
)
def test_camera_is_found_in_this_order(
    folder: Path,
    arguments: dict[str, str],
    variables: Mapping[str, str],
    found: tuple[str, str | None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, value in variables.items():
        monkeypatch.setenv(f"VEILCAM_{name}", value)
    own = profile_of(**arguments)
    assert (own.url, own.token) == found
    hall = own.url == HALL
    assert own.key == (folder / "hall.key" if hall else None)
    assert own.device == ("cd" * 32 if hall else None)
    assert own.certificate == ("ab" * 32 if hall else None)
    assert own.ca_file == (Path("/etc/hall.pem") if hall else None)
    assert not own.token or own.token not in repr(own)


def test_token_of_the_environment_is_for_the_default_profile_of_this_machine(
    settings: Path, receiver: ReceiverKey, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    add(receiver, made=Profile(DEFAULT_URL, "vc_operator", device="ef" * 32))
    assert profile_of().token == "vc_operator"
    (tmp_path / "token").write_text("vc_owner\n")
    monkeypatch.setenv("VEILCAM_TOKEN_FILE", str(tmp_path / "token"))
    own = profile_of()
    assert (own.token, own.key) == ("vc_owner", settings / "attic.key")
    assert profile_of(profile="attic").token == "vc_operator"


@pytest.mark.parametrize("kind", [Camera, AsyncCamera])
def test_camera_of_two_kinds_is_refused(kind: type) -> None:
    with pytest.raises(ArgumentError, match="a url and a profile name two cameras"):
        kind("http://127.0.0.1:1", profile="hall")
    with pytest.raises(ArgumentError, match="profile cannot be a int"):
        kind(profile=7)


@pytest.mark.parametrize("folder_of_settings", ["relative", "/dev/null"])
def test_no_file_is_no_default(folder_of_settings: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", folder_of_settings)
    assert profile_of().url == DEFAULT_URL
    with pytest.raises(ArgumentError, match="cannot be read"):
        profile_of(profile="hall")


def test_default_that_is_not_there_is_named(folder: Path) -> None:
    (folder / "config.toml").write_text('default = "hall"')
    with pytest.raises(ArgumentError, match="has no profile 'hall': it has none"):
        Camera()


def test_new_profile_is_the_users_alone(settings: Path, receiver: ReceiverKey) -> None:
    assert add(receiver) == ("attic", True)
    own = profile_of()
    assert own == Profile(
        MADE.url, "vc_attic", None, MADE.certificate, settings / "attic.key", MADE.device
    )
    assert ReceiverKey.read(settings / "attic.key").public == receiver.public
    assert settings.stat().st_mode & 0o777 == 0o700
    files = sorted(settings.iterdir())
    assert [file.name for file in files] == ["attic.key", "attic.token", "config.toml"]
    assert {file.stat().st_mode & 0o777 for file in files} == {0o600}
    assert "vc_attic" not in (settings / "config.toml").read_text()


@pytest.mark.parametrize("name", ["attic.key", "attic.token"])
@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620])
def test_secret_that_is_open_to_others_is_refused(
    settings: Path, receiver: ReceiverKey, kind: type, name: str, mode: int
) -> None:
    add(receiver)
    kind()
    (settings / name).chmod(mode)
    with pytest.raises(VeilcamError, match=rf"{name} is open to others: run chmod 600"):
        kind()


def test_new_profile_changes_no_other(folder: Path, receiver: ReceiverKey) -> None:
    file = folder / "config.toml"
    assert add(receiver, "hall") == ("hall-2", False)
    assert add(receiver, "hall") == ("hall-3", False)
    assert file.read_text().startswith(FILE)
    assert profile_of().url == HALL
    before = file.read_text()
    with (
        pytest.raises(ArgumentError, match="has a profile 'hall' already"),
        new_profile("hall", receiver, exact=True),
    ):
        pytest.fail("a name that is taken")
    assert file.read_text() == before


def test_same_camera_paired_again_is_the_default(folder: Path, receiver: ReceiverKey) -> None:
    again = Profile("https://hall.local:1", device="cd" * 32)
    assert add(receiver, "hall", again) == ("hall-2", True)
    assert profile_of().url == again.url
    assert profile_of(profile="hall").token == "vc_hall"
    assert (folder / "config.toml").read_text().count("default") == 1


def test_nothing_is_left_of_a_profile_that_failed(
    settings: Path, receiver: ReceiverKey, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = new_profile("attic", receiver, exact=True)
    made.__enter__()
    assert (settings / "attic.key").exists()
    error = RuntimeError("refused")
    assert not made.__exit__(RuntimeError, error, None)
    assert not settings.exists()

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("veilcam_client.profiles.os.fsync", full)
    with pytest.raises(FileError, match="cannot be written"):
        add(receiver)
    assert not settings.exists()


@pytest.mark.parametrize("text", ["profiles = {}\n", 'default = """\nhall"""\n'])
def test_file_that_cannot_be_added_to_is_left_alone_and_no_line_is_used(
    folder: Path, receiver: ReceiverKey, text: str
) -> None:
    (folder / "config.toml").write_text(text)
    before = sorted(folder.iterdir())
    if "default" in text:
        text += f'[profiles.hall]\nurl = "u"\ndevice = "{MADE.device}"\n'
        (folder / "config.toml").write_text(text)
    with (
        pytest.raises(FileError, match="in a way that no profile can be added to"),
        new_profile("attic", receiver, exact=False),
    ):
        pytest.fail("a line would be claimed now")
    assert (folder / "config.toml").read_text() == text
    assert sorted(folder.iterdir()) == before


def test_two_profiles_made_at_once_are_both_kept(settings: Path, receiver: ReceiverKey) -> None:
    with ThreadPoolExecutor() as threads:
        with new_profile("attic", receiver, exact=False) as (name, save):
            other = threads.submit(add, ReceiverKey.generate())
            with pytest.raises(TimeoutError):
                other.result(0.2)
            assert (name, save(MADE)) == ("attic", True)
        assert other.result(9) == ("attic-2", True)
    assert profile_of(profile="attic").key != profile_of(profile="attic-2").key


def test_folders_of_a_new_profile_are_the_users_alone_whatever_the_umask(
    settings: Path, receiver: ReceiverKey
) -> None:
    before = os.umask(0)
    try:
        add(receiver)
    finally:
        os.umask(before)
    assert {each.stat().st_mode & 0o077 for each in (settings.parent, *settings.iterdir())} == {0}


@pytest.mark.parametrize("text", [f"\ufeff{FILE}", FILE.replace("\n", "\r\n")])
def test_file_of_another_editor_is_added_to(folder: Path, receiver: ReceiverKey, text: str) -> None:
    (folder / "config.toml").write_text(text, newline="")
    assert add(receiver) == ("attic", False)
    assert profile_of().token == "vc_hall"
    assert profile_of(profile="attic").token == "vc_attic"


def test_file_that_is_a_link_stays_one(
    settings: Path, receiver: ReceiverKey, tmp_path: Path
) -> None:
    settings.mkdir(parents=True)
    (tmp_path / "mine.toml").write_text("# mine\n")
    profiles_path().symlink_to(tmp_path / "mine.toml")
    add(receiver)
    assert profiles_path().is_symlink()
    assert profile_of().token == "vc_attic"
    assert not (tmp_path / "attic.key").exists()


@pytest.mark.parametrize("name", ["", "a/b", "..", "a b", "a" * 65, "ä"])
def test_name_that_can_be_no_file_is_refused(
    settings: Path, receiver: ReceiverKey, name: str
) -> None:
    with pytest.raises(ArgumentError, match="no name of a profile"):
        add(receiver, name)
    assert not settings.exists()
