"""The siege in its short form: every row against the daemon as it is, and the command."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from veilcam_server.cli.siege import SERVE
from veilcam_server.siege.ground import SHORT
from veilcam_server.siege.run import ROWS, besiege

ROOT = Path(__file__).parents[2]
BY_COMMAND = "kill"
"""The row that is tried by the command."""


@pytest.mark.slow
@pytest.mark.parametrize("row", [row for row in ROWS if row != BY_COMMAND])
def test_the_daemon_withstands(row: str) -> None:
    [verdict] = besiege(SERVE, SHORT, [row])
    judgement = verdict.judgement
    if judgement.outcome == "untried":
        pytest.skip(str(judgement.untried))
    # How long an answer took depends on what else this machine does; the long form measures it.
    assert [part for part in judgement.missed if " ms " not in part] == []


@pytest.mark.slow
def test_the_command_says_what_it_found_and_figures_are_recorded(tmp_path: Path) -> None:
    figures, keys = tmp_path / "figures.json", tmp_path / "keys.json"
    command = [sys.executable, "-m", "tests.stress.siege", "--short", "--only", BY_COMMAND]
    ended = subprocess.run(
        [*command, "--figures", str(figures), "--keys", str(keys)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert f"passed   {BY_COMMAND}" in ended.stdout
    assert read(figures) == {"kills": SHORT.kills, "kills_lost": 0, "epochs_repeated": 0}
    assert read(keys) == {"epochs_repeated": 0}


def read(figures: Path) -> dict[str, float]:
    return {name: entry["value"] for name, entry in json.loads(figures.read_text()).items()}
