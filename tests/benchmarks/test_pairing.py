"""Attacks on pairing, made short: none is won, and each claim stands in the log."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer
from benchmarks.privacy import pairing
from tests.benchmarks.conftest import figures_of
from typer.testing import CliRunner


@pytest.mark.slow
def test_pairing_holds_against_each_attack(tmp_path: Path) -> None:
    app = typer.Typer()
    app.command()(pairing.main)
    path = tmp_path / "people.json"
    answer = CliRunner().invoke(app, ["--quick", "--figures", str(path)])
    assert answer.exit_code == 0, answer.output
    assert figures_of(path) == {"pairing_attacks_won": 0}
