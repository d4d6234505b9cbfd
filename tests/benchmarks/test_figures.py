"""The record of figures keeps what others wrote and says what made each."""

from __future__ import annotations

import json
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from benchmarks.figures import check_record, record_figures

from veilcam_training.errors import TrainingError


def test_figures_are_merged(tmp_path: Path) -> None:
    path = tmp_path / "results" / "a.json"
    record_figures(path, {"one": 1.0, "two": 2.0}, ["python", "x.py", "a b"])
    record_figures(path, {"two": 3.0})
    record = json.loads(path.read_text())
    assert record["one"]["value"] == 1.0
    assert record["two"]["value"] == 3.0
    assert record["one"]["command"] == "python x.py 'a b'"
    assert record["one"].keys() == {"value", "command", "commit", "date", "machine"}
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", record["one"]["date"])
    assert record["one"]["machine"].endswith("cores")
    assert [file.name for file in path.parent.iterdir()] == ["a.json"]


def test_figures_of_two_writers_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda i: record_figures(path, {f"n{i}": i}, ["x"]), range(12)))
    assert len(json.loads(path.read_text())) == 12


def test_figures_that_cannot_be_kept_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    with pytest.raises(TrainingError, match="finite"):
        record_figures(path, {"a": float("nan")})
    path.write_text("[]")
    for place, reason in (
        (path, "not a record"),
        (tmp_path, "not a record"),
        (path / "b.json", "cannot be written to"),
        (Path("/proc/a.json"), "cannot be written to"),
    ):
        with pytest.raises(TrainingError, match=reason):
            record_figures(place, {"a": 1.0})
        with pytest.raises(TrainingError, match=reason):
            check_record(place)
