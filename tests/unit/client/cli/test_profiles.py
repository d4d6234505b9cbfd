"""Which camera is asked, and with whose token."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from veilcam_client.cli.main import app
from veilcam_client.profiles import profiles_path

runner = CliRunner()


@pytest.fixture
def folder(settings: Path) -> Path:
    settings.mkdir(parents=True)
    return settings


@pytest.fixture
def elsewhere(url: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A profile of the daemon, beside an environment that names another camera."""
    token = folder / "hall.token"
    token.write_text("vc_hall\n")
    token.chmod(0o600)
    (folder / "config.toml").write_text(
        f'[profiles.hall]\nurl = "{url}"\ntoken_file = "hall.token"\n'
        f'[profiles.open]\nurl = "{url}"\n'
    )
    monkeypatch.setenv("VEILCAM_URL", "http://127.0.0.1:1")
    monkeypatch.setenv("VEILCAM_TOKEN", "vc_elsewhere")
    return folder


def test_camera_is_told_its_own_token(
    elsewhere: Path, url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str | None] = []
    monkeypatch.setattr(
        "veilcam_client.cli.terminal.Camera.status",
        lambda camera: told.append(camera._transport.options.credentials.token),
    )
    other = elsewhere / "other"
    other.write_text("vc_other")
    for options in (
        ["status", "--profile", "hall"],
        ["status", "--profile", "open"],
        ["status", "--url", url],
        ["status", "--token-file", str(other)],
        ["status", "--profile", "hall", "--token-file", str(other)],
    ):
        runner.invoke(app, options)
    assert told == ["vc_hall", None, "vc_elsewhere", "vc_other", "vc_other"]


@pytest.mark.usefixtures("elsewhere")
def test_token_of_a_profile_goes_to_no_other_camera() -> None:
    result = runner.invoke(app, ["status", "--profile", "hall", "--url", "http://127.0.0.1:2"])
    assert result.exit_code == 2
    assert (
        result.stderr == "veilcam: error: a url and a profile name two cameras: give one of them\n"
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "cannot be read: No such file"),
        ("[profiles", "cannot be read: "),
        ("", "has no profile 'hall': it has none"),
        ('[profiles.a]\nurl = "u"\n[profiles.b]\nurl = "u"', "it has a, b"),
        ("[profiles.hall]", "profiles.hall.url: Field required"),
        ('[profiles.hall]\nurl = "u"\ntoken = "vc_hidden"', "name that as token_file"),
        ('[profiles.hall]\nurl = "u"\ntoken_file = "none"', "none cannot be read"),
        ('[profiles.hall]\nurl = "u"\ndevice = "ab"', "profiles.hall.device: String should match"),
        ('[profiles.hall]\nurl = "u"\ntoken_file = "open"', "open is open to others: run chmod"),
        ("colour = 1", "colour: Extra inputs"),
    ],
)
def test_file_that_cannot_be_used_is_named(folder: Path, text: str | None, message: str) -> None:
    if text is not None:
        (folder / "config.toml").write_text(text)
    (folder / "open").write_text("vc_hidden")
    (folder / "open").chmod(0o640)
    result = runner.invoke(app, ["status", "--profile", "hall"])
    assert result.exit_code == 2
    (line,) = result.stderr.splitlines()
    assert message in line
    assert str(folder) in line
    assert "hidden" not in line


def test_file_that_others_can_change_is_refused(folder: Path, url: str) -> None:
    file = folder / "config.toml"
    file.write_text(f'default = "hall"\n[profiles.hall]\nurl = "{url}"\n')
    file.chmod(0o620)
    for options in (["--profile", "hall"], ["--url", url]):
        result = runner.invoke(app, ["status", *options], env={"VEILCAM_URL": ""})
        refused = options[0] == "--profile"
        assert result.exit_code == (2 if refused else 0)
        assert ("can be changed by others: run chmod 600" in result.stderr) is refused


def test_profiles_file_is_where_users_keep_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    monkeypatch.setenv("HOME", "/home/me")
    assert profiles_path() == Path("/home/me/.config/veilcam/config.toml")
