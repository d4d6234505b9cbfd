"""Proofs against a real daemon, made short: what is planted, what stays, and what it costs."""

from __future__ import annotations

from pathlib import Path

import pytest
from benchmarks.privacy.keys import served
from tests.benchmarks.conftest import figures_of
from tests.unit.server.conftest import make_fresh_bundle

from veilcam_training.bundle import write_bundle


@pytest.fixture
def bundle_file(tmp_path: Path) -> Path:
    path = tmp_path / "fresh.veilcam"
    write_bundle(path, make_fresh_bundle())
    return path


@pytest.mark.thorough
def test_planted_scenes_become_figures(bundle_file: Path, tmp_path: Path) -> None:
    figures, work = tmp_path / "figures.json", tmp_path / "work"
    served.answers(work, count=20, bundle=bundle_file, epochs=1, figures=figures)
    found = figures_of(figures)
    assert found["clear_part_differences"] == 0
    # 20 against 20: a standard error of .09.
    assert abs(found["clear_part_auc"] - 0.5) < 0.35
    (record,) = work.iterdir()
    assert len(record.read_text().splitlines()) == 40


@pytest.mark.slow
def test_past_of_a_daemon_that_is_taken_is_closed(bundle_file: Path, tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    # It raises where not even the epoch that goes on is found.
    served.past(captures=6, step=16, bundle=bundle_file, figures=figures)
    found = figures_of(figures)
    assert found["past_opened"] == 0
    assert found["past_levels_found"] == 0
