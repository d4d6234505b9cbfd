"""Captures of fresh masks are collected in every form, and every row is attacked once."""

from __future__ import annotations

from pathlib import Path

import pytest
from benchmarks.privacy import fresh_worst
from benchmarks.privacy.fresh_worst import measure
from benchmarks.privacy.keys.scenes import load_scenes
from tests.benchmarks.conftest import figures_of

from veilcam_server.demo_data import FRESH
from veilcam_training.attacks.intervals import Gain
from veilcam_training.attacks.keyless import Asked
from veilcam_training.bundle import read_bundle


@pytest.mark.slow
def test_rows_are_attacked_once_and_the_worst_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fresh_worst, "CHUNK", 30)
    scenes = load_scenes(read_bundle(FRESH).scene.shape, None, None)
    monkeypatch.setattr(fresh_worst, "load_scenes", lambda *_: scenes)
    tried: list[tuple[str, str]] = []

    def counted(asked: Asked, family: str, **_: object) -> Gain:
        tried.append((asked.kind, family))
        assert len(asked.vectors) == 60
        return Gain(0.3 if asked.kind == "class" else 0.015, 1e-6, *_bar(asked))

    def _bar(asked: Asked) -> tuple[float, int, float]:
        return (1.0 if asked.kind == "class" else 0.02), 100, 0.5

    monkeypatch.setattr(fresh_worst, "gain", counted)
    figures = tmp_path / "figures.json"
    for _ in range(2):
        measure(data=tmp_path, work=tmp_path / "work", masks=60, figures=figures)
    # Two forms, four questions without faces, three families: each once.
    assert len(tried) == 24
    record = figures_of(figures)
    assert record == {
        "fresh_worst_advantage_upper": pytest.approx(0.75, abs=0.001),
        "fresh_worst_masks": 60,
        "fresh_worst_rows": 24,
    }
