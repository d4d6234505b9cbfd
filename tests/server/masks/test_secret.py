"""The secret of fresh masks: made once, read by its owner alone, shown to nobody."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from veilcam_optics.keys.masks import Secret
from veilcam_server.cli.main import app
from veilcam_server.errors import StartError
from veilcam_server.masks.secret import find_secret, write_secret

runner = CliRunner()


def test_the_command_makes_one_for_its_owner_alone_and_does_not_show_it(tmp_path: Path) -> None:
    path = tmp_path / "mask-secret"
    result = runner.invoke(app, ["secret", str(path)])
    assert result.exit_code == 0, result.output
    assert path.stat().st_mode & 0o777 == 0o600
    secret = find_secret(path)
    assert secret.reveal().hex() not in result.output
    assert f"--mask-secret {path}" in result.stdout


def test_two_secrets_differ(tmp_path: Path) -> None:
    for name in "ab":
        write_secret(tmp_path / name)
    assert find_secret(tmp_path / "a") != find_secret(tmp_path / "b")


def test_a_secret_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "mask-secret"
    write_secret(path)
    before = path.read_bytes()
    result = runner.invoke(app, ["secret", str(path)])
    assert result.exit_code == 1
    assert "was left alone" in result.stderr
    assert path.read_bytes() == before
    result = runner.invoke(app, ["secret", str(tmp_path / "no" / "folder")])
    assert result.exit_code == 1
    assert "cannot be written" in result.stderr


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660])
def test_a_file_that_others_may_read_is_refused(secret_file: Path, mode: int) -> None:
    secret_file.chmod(mode)
    with pytest.raises(StartError, match="chmod 600"):
        find_secret(secret_file)


@pytest.mark.parametrize("content", ["", "00" * 31, "zz" * 32, "\xff" * 64])
def test_what_is_no_secret_is_refused_and_not_repeated(secret_file: Path, content: str) -> None:
    secret_file.write_text(content)
    with pytest.raises(StartError, match="64 hexadecimal digits") as caught:
        find_secret(secret_file)
    assert not content or content not in str(caught.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(StartError, match="check the path"):
        find_secret(tmp_path / "nothing")
    with pytest.raises(StartError, match="make one with 'veilcamd secret FILE'"):
        find_secret(None)


def test_the_credential_of_systemd(
    tmp_path: Path, secret: Secret, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    with pytest.raises(StartError, match="'mask-key'"):
        find_secret(None)
    credential = tmp_path / "mask-key"
    credential.write_text(secret.reveal().hex() + "\n")
    # An access list of systemd's shows as a permission of the group.
    credential.chmod(0o440)
    assert find_secret(None) == secret
    other = tmp_path / "other"
    write_secret(other)
    assert find_secret(other) != secret  # what is said outright comes first
    credential.chmod(0o600)
    credential.write_text("nonsense")
    with pytest.raises(StartError, match="64 hexadecimal digits"):
        find_secret(None)
