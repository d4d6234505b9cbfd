"""Cards side by side: modes that there are masks for, and figures under their names."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from benchmarks.privacy import card
from tests.unit.training.attacks.card.conftest import TINY, make_fresh, make_images, make_pairs
from typer.testing import CliRunner

from veilcam_training.bundle import write_bundle


def test_modes_without_masks_are_left_out() -> None:
    fresh = make_fresh()
    modes = card._modes(make_pairs(12), fresh)
    assert list(modes) == ["pairs1", "pairs10", "random", "fresh"]
    assert modes["fresh"] is fresh


@pytest.mark.thorough
def test_figures_of_a_mode_are_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pairs, fresh = tmp_path / "pairs.veilcam", tmp_path / "fresh.veilcam"
    write_bundle(pairs, make_pairs())
    write_bundle(fresh, make_fresh())
    monkeypatch.setattr(card, "QUICK", replace(TINY, own=20, seen=20, epochs=2))
    monkeypatch.setattr(card, "shipped_digits", make_images)
    figures, work = tmp_path / "privacy.json", tmp_path / "work"
    options = ["compare", "--work", work, "--pairs", pairs, "--fresh", fresh, "--quick"]
    options += ["--mode", "random", "--form", "sealed", "--figures", figures]
    with torch.random.fork_rng():
        result = CliRunner().invoke(card.app, [str(each) for each in options])
    assert result.exit_code == 0, result.output
    recorded = json.loads(figures.read_text())
    assert set(recorded) == {f"card_random_T{number}" for number in range(10)}
    assert (work / "random" / "card.html").exists()
