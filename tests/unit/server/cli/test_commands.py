"""What holds for every command of ``veilcamd``."""

from __future__ import annotations

import json
import re
import stat
from pathlib import Path

import pytest
import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command
from typer.testing import CliRunner

from veilcam_client import __version__
from veilcam_client.cli.main import app as client_app
from veilcam_client.wire.tokens import SCOPES
from veilcam_server.cli.main import app
from veilcam_server.cli.serve import set_scene
from veilcam_server.demo_data import load_digits

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


def test_version_is_that_of_the_package() -> None:
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


@pytest.mark.parametrize("command", [app, client_app], ids=["veilcamd", "veilcam"])
def test_scopes_are_all_told_and_an_unknown_one_is_named_once(command: typer.Typer) -> None:
    told = runner.invoke(command, ["token", "create", "--help"]).stdout
    # A terminal breaks lines, and may draw a box around them.
    assert f"Oneof{','.join(SCOPES)}." in re.sub(r"[\s│]", "", told)
    wrong = ["--scope", "classify", "--scope", "read:everything", "--scope", "see"]
    refused = runner.invoke(command, ["token", "create", "--label", "x", *wrong])
    assert refused.exit_code != 0
    (line,) = refused.stderr.splitlines()
    assert "--scope 'read:everything' --scope 'see': there is no such scope: use read:st" in line
    assert "--scope 'classify'" not in line


def test_state_folder_that_begins_with_a_scene_is_its_owner_s_alone(tmp_path: Path) -> None:
    set_scene(tmp_path / "state" / "scene.npy", load_digits(), 0)
    assert stat.S_IMODE((tmp_path / "state").stat().st_mode) == 0o700
