"""Tutorial "Your own pictures": its commands run as they are written."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "own-pictures.md"
SERVE = "veilcamd serve "


def command_lines() -> list[str]:
    """Return the commands of the page, in order."""
    return re.findall(r"^    (veilcam\S* .*)$", PAGE.read_text(), re.MULTILINE)


def run(line: str, **environment: str) -> str:
    """Run a command of the page, and return what it prints."""
    words = shlex.split(line)
    command = [str(Path(sys.executable).with_name(words[0])), *words[1:]]
    return subprocess.run(
        command, check=True, stdout=subprocess.PIPE, text=True, env={**os.environ, **environment}
    ).stdout


@contextmanager
def serving(line: str) -> Iterator[str]:
    """Run the page's daemon on a free port, and yield its URL."""
    words = shlex.split(line)
    command = [str(Path(sys.executable).with_name(words[0])), *words[1:]]
    environment = {**os.environ, "VEILCAM_PORT": "0", "VEILCAM_STATE_DIR": "state"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().split()[-1]
        finally:
            process.terminate()


@pytest.mark.slow
@pytest.mark.thorough
def test_tutorial_leads_from_pictures_to_labels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    draw, fit, serve, classify, predict = command_lines()
    run(draw)
    assert "report.html" in run(fit)
    with serving(serve) as url:
        assert "star" in run(classify, VEILCAM_URL=url)
    lines = [line.split("\t") for line in run(predict).splitlines()]
    right = sum(Path(path).parent.name == label for path, label, _ in lines)
    # Chance is a fifth; two other fits within this budget or twice as much read all.
    assert len(lines) == 400
    assert right >= 0.9 * len(lines)
    made = {path.name for path in Path("fitted").iterdir()}
    assert {"report.html", "history.csv", "accuracy.png", "confusion.png", "worst.png"} <= made
