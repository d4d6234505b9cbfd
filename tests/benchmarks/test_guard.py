"""Figures of the guard, made short."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from benchmarks.guard import served, verdicts
from benchmarks.guard.__main__ import app
from benchmarks.guard.world import shipped
from typer.testing import CliRunner

from veilcam_server.demo_data import BUNDLE


@pytest.mark.numerical
def test_faults_and_sound_cameras_are_told_apart() -> None:
    random = np.random.default_rng(1)
    found = verdicts.faults(verdicts.optics_of(random), random, 12, verdicts.LIGHTS)
    assert verdicts.answered(found) == 0
    assert sum(count for (*_, name), count in found.items() if name == "accused") > 30
    sound = verdicts.Sound(random, 2)
    came = sound.changes(100, (0.1, 3.0))
    assert sum(came.values()) == 100
    assert not any("accused" in name for name in came)


def test_lost_transfers_leave_wrong_masks_only_where_masks_are_written_once() -> None:
    _, masks = shipped(BUNDLE, np.random.default_rng(3), 3)
    assert served.lost_transfers(13, 6, masks, guarded=False) > 0
    assert served.lost_transfers(13, 6, masks, guarded=True) == 0


@pytest.mark.numerical
def test_chart_is_drawn(tmp_path: Path) -> None:
    path = tmp_path / "guard.png"
    answer = CliRunner().invoke(app, ["chart", str(path), "--tries", "2"])
    assert answer.exit_code == 0, answer.output
    assert path.read_bytes().startswith(b"\x89PNG")
