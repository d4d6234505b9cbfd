"""What holds for every command of ``veilcamd``."""

from __future__ import annotations

import json
from pathlib import Path

from typer.core import TyperCommand, TyperGroup
from typer.main import get_command
from typer.testing import CliRunner

from veilcam_client import __version__
from veilcam_server.cli.main import app

runner = CliRunner()
PERSONS = {"serve", "demo"}
"""Commands that answer nobody: what they say on the way is for a person."""


def test_every_command_that_answers_speaks_json() -> None:
    group = get_command(app)
    assert isinstance(group, TyperGroup)
    leaves = dict(group.commands)
    tokens = leaves.pop("token")
    assert isinstance(tokens, TyperGroup)
    leaves.update(tokens.commands)
    silent = {
        name
        for name, command in leaves.items()
        if isinstance(command, TyperCommand)
        and not any("--json" in each.opts for each in command.params)
    }
    assert silent == PERSONS


def test_its_version_is_that_of_the_package() -> None:
    assert runner.invoke(app, ["--version"]).stdout == f"veilcamd {__version__}\n"


def test_tokens_and_digits_are_told_as_json(tmp_path: Path) -> None:
    state = ["--state-dir", str(tmp_path), "--json"]
    made = runner.invoke(app, ["token", "create", "--label", "a", "--scope", "classify", *state])
    token = json.loads(made.stdout)
    assert token["secret"].startswith("vc_")
    assert token["scopes"] == ["classify"]
    revoked = json.loads(runner.invoke(app, ["token", "revoke", token["id"], *state]).stdout)
    assert revoked["revoked_at"] is not None
    assert "secret" not in revoked
    scene = tmp_path / "scene.npy"
    shown = runner.invoke(app, ["show", "--scene", str(scene), "--index", "3", "--json"])
    held = json.loads(shown.stdout)
    assert (held["index"], held["file"]) == (3, str(scene))
