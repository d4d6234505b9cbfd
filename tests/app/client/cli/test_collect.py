"""``veilcam collect`` against a canned daemon on a real socket."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from tests.unit.client.conftest import Daemon
from typer.testing import CliRunner

from veilcam_client.cli.main import app

pytestmark = pytest.mark.usefixtures("url")
runner = CliRunner()


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    for label in "17":
        for number in range(2):
            picture = tmp_path / "pictures" / label / f"{number}.png"
            picture.parent.mkdir(parents=True, exist_ok=True)
            picture.write_bytes(b"\x89PNG" + label.encode())
    return tmp_path / "pictures"


def labels(path: Path) -> list[str]:
    return [json.loads(line)["label"] for line in path.read_text().splitlines()[1:]]


def test_person_says_what_is_there(tmp_path: Path) -> None:
    file = tmp_path / "out.jsonl"
    result = runner.invoke(app, ["collect", str(file)], input="7\ncat\n1\n\n")
    assert result.exit_code == 0, result.output
    assert "2 measurements more" in result.stdout
    assert "'cat' is none of them" in result.stderr
    assert labels(file) == ["7", "1"]


def test_pictures_are_held_up_and_taken_away(
    tmp_path: Path, pictures: Path, daemon: Daemon
) -> None:
    file = tmp_path / "out.jsonl"
    command = ["collect", str(file), str(pictures), "--per-class", "1", "--json"]
    found = runner.invoke(app, command)
    assert found.exit_code == 0, found.output
    assert json.loads(found.stdout) == {"added": 2, "file": str(file)}
    asked = [
        (each.method, each.content)
        for each in daemon.requests
        if each.url.path == "/v1/simulation/scene"
    ]
    assert asked == [
        *(("PUT", b"\x89PNG1"), ("DELETE", b"")),
        *(("PUT", b"\x89PNG7"), ("DELETE", b"")),
    ]
    assert labels(file) == ["1", "7"]


def test_viewer_shows_each_picture_and_is_ended(tmp_path: Path, pictures: Path) -> None:
    shown, script = tmp_path / "shown", tmp_path / "viewer.py"
    script.write_text(
        "import sys, time\n"
        f"with open({str(shown)!r}, 'a') as log: log.write(sys.argv[1] + chr(10))\n"
        "time.sleep(600)\n"
    )
    viewer, file = f"{sys.executable} {script}", tmp_path / "out.jsonl"
    command = ["collect", str(file), str(pictures), "--per-class", "1", "--viewer", viewer]
    # Long enough for an interpreter to start on a busy machine; what it shows is read afterwards.
    result = runner.invoke(app, [*command, "--pause", "0.5"])
    assert result.exit_code == 0, result.output
    assert labels(file) == ["1", "7"]
    assert set(shown.read_text().split()) <= {str(pictures / label / "0.png") for label in "17"}


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--viewer", "/no/such/viewer"], "cannot be run"),
        (["--viewer", "true", "--pause", "600"], "has ended before"),
    ],
)
def test_viewer_that_shows_nothing_is_refused(
    tmp_path: Path, pictures: Path, options: list[str], why: str
) -> None:
    result = runner.invoke(app, ["collect", str(tmp_path / "out"), str(pictures), *options])
    assert result.exit_code == 2
    assert why in result.stderr


@pytest.mark.parametrize("options", [["--per-class", "1"], ["--viewer", "true"]])
def test_option_of_pictures_is_refused_without_a_folder(tmp_path: Path, options: list[str]) -> None:
    result = runner.invoke(app, ["collect", str(tmp_path / "out"), *options])
    assert result.exit_code == 2
    assert "go with FOLDER" in result.stderr
