"""What holds for every command of ``veilcam``, and pictures."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.unit.client.conftest import Daemon, events
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command
from typer.testing import CliRunner

from veilcam_client import __version__
from veilcam_client.cli.main import app
from veilcam_client.cli.terminal import EXIT_CODES, FORGED, USAGE
from veilcam_client.numbers import in_blocks

runner = CliRunner()
PAGE = Path(__file__).resolve().parents[4] / "docs" / "cli.md"


def leaves(command: object, path: str) -> Iterator[tuple[str, set[str]]]:
    if isinstance(command, TyperGroup):
        for name, inner in command.commands.items():
            yield from leaves(inner, f"{path} {name}")
    elif isinstance(command, TyperCommand):
        yield path, {option for each in command.params for option in each.opts}


def test_every_command_speaks_json() -> None:
    commands = dict(leaves(get_command(app), "veilcam"))
    assert len(commands) > 15
    assert [name for name, options in commands.items() if "--json" not in options] == []


def test_version_is_that_of_the_package() -> None:
    assert runner.invoke(app, ["--version"]).stdout == f"veilcam {__version__}\n"


def test_page_has_the_code_of_every_class_of_errors() -> None:
    rows = re.findall(r"^\| (\d+) \| `?(\w+)`?", PAGE.read_text(), re.MULTILINE)
    told = {name: int(code) for code, name in rows}
    assert {kind.__name__: code for kind, code in EXIT_CODES}.items() <= told.items()
    assert {USAGE, FORGED} <= set(told.values())


@pytest.mark.usefixtures("url")
def test_capture_becomes_a_picture(tmp_path: Path) -> None:
    out = tmp_path / "e.PNG"
    assert runner.invoke(app, ["capture", "--out", str(out)]).exit_code == 0
    picture = np.asarray(Image.open(out))
    rows, columns = picture.shape
    assert (rows % 2, columns % 3) == (0, 0)
    assert picture[0, 0] == 0
    assert picture[-1, -1] == 255


@pytest.mark.usefixtures("url")
def test_watch_draws_what_is_seen_when_it_is_wanted(daemon: Daemon) -> None:
    seen = {"kind": "seen", "label": "7", "duration_s": 1.0}
    daemon.first = [events({"kind": "mask", "epoch": "e1"}, seen)]
    shown = runner.invoke(app, ["events", "--count", "2", "--picture"], color=True).stdout
    mask, label, drawn = shown.splitlines()
    assert "e1" in mask
    assert "7" in label
    assert drawn.count("▀") == 3
    assert [request.url.path for request in daemon.requests] == ["/v1/events", "/v1/captures"]
    refused = runner.invoke(app, ["events", "--picture", "--json"])
    assert refused.exit_code == 2


def test_drawing_has_two_values_a_character() -> None:
    values = np.array([[0.0, 1.0], [2.0, 23.0], [23.0, 0.0]], np.float32)
    assert in_blocks(values) == (
        "\x1b[38;5;232;48;5;234m▀\x1b[38;5;233;48;5;255m▀\x1b[0m\n"
        "\x1b[38;5;255;48;5;232m▀\x1b[38;5;232;48;5;232m▀\x1b[0m"
    )
    assert "nan" not in in_blocks(np.ones((2, 2), np.float32))
    assert in_blocks(np.ones((3, 4, 2), np.float32)).count("▀") == 2 * 6
