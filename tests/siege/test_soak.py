"""The soak of engine and emulated hardware, made short; and that it would notice a failure."""

from __future__ import annotations

import itertools
import json
import random
import subprocess
import sys
from pathlib import Path

import pytest
from tests.siege import engine, soak

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_server.camera.camera import MaskedCamera

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def supply() -> engine.Supply:
    return engine.Supply()


@pytest.fixture(autouse=True)
def _seeded() -> None:
    random.seed(5)


@pytest.mark.slow
def test_nothing_is_mixed_reused_or_lost(tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    result = subprocess.run(
        [
            *(sys.executable, "-m", "tests.siege.soak", "--captures", "60", "--kills", "3"),
            *("--faults", "0.3", "--figures", str(figures)),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    record = {name: entry["value"] for name, entry in json.loads(figures.read_text()).items()}
    assert record.pop("soak_growth_mb") < 20
    assert record == {"soak_captures": 60, "soak_mixed": 0, "soak_reused": 0, "soak_lost": 0}


@pytest.mark.slow
def test_faults_become_errors_and_engines_are_started_again(
    supply: engine.Supply, tmp_path: Path
) -> None:
    outcome = soak.soak(supply, tmp_path, 80, faults=0.5, restart_every=20)
    assert outcome.errors > 0
    assert outcome.captures > 40
    assert outcome.mixed == outcome.reused == outcome.lost == 0


def test_a_fence_without_settling_is_noticed(supply: engine.Supply, tmp_path: Path) -> None:
    assert soak.soak(supply, tmp_path, 40, faults=0.0, granted=0.0).mixed > 0


def test_a_kernel_that_repeats_itself_is_noticed(
    supply: engine.Supply, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = itertools.cycle(range(1, 8))

    def generate(*, device: str, bundle: str) -> EpochKey:
        return EpochKey(bytes([next(drawn)]) * 32, device=device, bundle=bundle)

    monkeypatch.setattr(EpochKey, "generate", generate)
    assert soak.soak(supply, tmp_path, 20, faults=0.0).reused > 0


def test_a_name_that_comes_again_is_noticed(
    supply: engine.Supply, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = itertools.cycle(range(7))
    monkeypatch.setattr(
        "veilcam_server.camera.epochs.secrets.token_hex", lambda _: f"{next(names):032x}"
    )
    outcome = soak.soak(supply, tmp_path, 20, faults=0.0)
    assert outcome.reused > 0
    assert outcome.lost > 0  # the receiver, too, refuses what comes again


def test_an_unknown_exception_counts_as_lost(
    supply: engine.Supply, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(MaskedCamera, "capture", fail)
    assert soak.soak(supply, tmp_path, 3, faults=0.0).lost == 3
