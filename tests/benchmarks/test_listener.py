"""Listener behind TLS, made short."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from benchmarks.privacy.listener import app, area_upper
from tests.benchmarks.conftest import figures_of
from typer.testing import CliRunner


@pytest.mark.slow
def test_listener_sees_one_size(tmp_path: Path) -> None:
    path = tmp_path / "privacy.json"
    answer = CliRunner().invoke(app, ["--quick", "--figures", str(path)])
    assert answer.exit_code == 0, answer.output
    found = figures_of(path)
    assert found["listener_sizes_a_route"] == 1
    assert found["beat_mb_per_day"] > 10


def test_attacker_finds_what_a_feature_tells_and_nothing_in_noise() -> None:
    random = np.random.default_rng(1)
    kinds, noise = random.random(400) < 0.5, random.normal(size=(400, 30))
    assert area_upper(noise, kinds) < 0.65
    noise[:, 17] += 3 * kinds
    assert area_upper(noise, kinds) > 0.9
