"""The benchmark of fresh masks in the daemon, made short; and that it would notice a failure."""

from __future__ import annotations

import importlib.util
import itertools
import json
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from veilcam_server.camera.epochs import EpochStore

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "daemon" / "fresh.py"


@pytest.fixture(scope="module")
def benchmark() -> ModuleType:
    spec = importlib.util.spec_from_file_location("daemon_fresh", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def nothing() -> None:
    pass


def test_nothing_repeats_mixes_or_leaks(tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    result = subprocess.run(
        [
            *(sys.executable, str(SCRIPT), "--captures", "120", "--kills", "6"),
            *("--figures", str(figures)),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    written = {name: entry["value"] for name, entry in json.loads(figures.read_text()).items()}
    assert written["epochs_run"] >= 120
    assert (written["epochs_repeated"], written["frames_mixed"]) == (0, 0)
    assert re.search(r"captures: 120 over \d+ epochs, 0 repeated, 0 frames mixed", result.stdout)


def test_a_panel_that_is_not_given_its_time_mixes_frames(
    benchmark: ModuleType, tmp_path: Path
) -> None:
    setting = benchmark.Setting.make()
    assert benchmark.soak(setting, tmp_path, 20, nothing).mixed == 0
    assert benchmark.soak(setting, tmp_path, 20, nothing, settle=0.5, granted=0.0).mixed > 0


def test_a_counter_that_is_not_durable_repeats_epochs(
    benchmark: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    setting = benchmark.Setting.make()

    def two_lives() -> int:
        lives = [benchmark.soak(setting, tmp_path, 10, nothing) for _ in range(2)]
        assert [life.repeated for life in lives] == [0, 0]
        repeated: int = benchmark.repeats([mask for life in lives for mask in life.masks])
        return repeated

    assert two_lives() == 0
    counters = itertools.count(1)

    def forgetful(self: EpochStore) -> int:
        return next(counters)

    init = EpochStore.__init__

    def again(self: EpochStore, directory: Path, now: object = None) -> None:
        nonlocal counters
        counters = itertools.count(1)
        init(self, directory)

    monkeypatch.setattr(EpochStore, "next", forgetful)
    monkeypatch.setattr(EpochStore, "__init__", again)
    assert two_lives() >= 10
