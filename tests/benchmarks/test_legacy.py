"""Rows of attacks on old forms are kept when done, and say whether they reached what they must."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from benchmarks.privacy.legacy import __main__ as legacy
from benchmarks.privacy.legacy.rows import ROWS, Found, Row
from benchmarks.privacy.legacy.setting import Setting
from typer.testing import CliRunner


class NoSetting:
    """Takes the place of pictures and cameras."""

    def __init__(self, data: Path, faces: Path | None) -> None:
        self.said = data, faces


def test_a_run_that_is_kept_is_not_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    def measure(setting: Setting, number: int) -> Found:
        asked.append(number)
        return {"low": 1.0 + number, "high": 2.0 + number}

    monkeypatch.setattr(legacy, "ROWS", {"row": Row(measure, 2, {"low": 9.0, "high": 2.5})})
    monkeypatch.setattr(legacy, "Setting", NoSetting)
    figures, work = tmp_path / "figures.json", tmp_path / "work"
    told = ["--data", str(tmp_path), "--work", str(work), "--figures", str(figures)]
    first = CliRunner().invoke(legacy.app, ["all", *told])
    assert first.exit_code == 0, first.output
    assert "low: 1.5 of 9, NOT REACHED (1, 2)" in first.output
    assert "high: 2.5 of 2.5, reached (2, 3)" in first.output
    assert json.loads(figures.read_text())["high"]["value"] == 2.5
    assert asked == [0, 1]
    (work / "row-1.json").unlink()
    assert CliRunner().invoke(legacy.app, ["row", *told]).exit_code == 0
    assert asked == [0, 1, 1]
    assert CliRunner().invoke(legacy.app, ["other", *told]).exit_code == 2


def test_every_row_is_of_several_masks_or_seeds() -> None:
    assert all(row.runs in (3, 5) for row in ROWS.values())
    names = [name for row in ROWS.values() for name in row.reach]
    assert len(names) == len(set(names))
    assert all(name.endswith("_legacy") for name in names)
