"""The benchmark of the daemon's overhead, made short; and what it counts as overhead."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from tests.server.scripts import load_script

from veilcam_client.wire.captures import Timing

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "daemon" / "overhead.py"


def test_overhead_is_what_the_device_did_not_take() -> None:
    timing = Timing(
        queue_s=0.2,
        rotation_s=0.1,
        settle_s=0.05,
        capture_s=0.04,
        inference_s=0.03,
        total_s=0.45,
    )
    request = load_script(SCRIPT).Request(0.5, timing)
    assert request.device == pytest.approx(0.39)
    assert request.overhead == pytest.approx(0.11)


def test_figures_of_clients_at_the_same_time(tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    result = subprocess.run(
        [sys.executable, str(SCRIPT), "--clients", "2", "--count", "3", "--figures", str(figures)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert "6 requests of 2 plain clients" in result.stdout
    assert "6 requests of 2 SDK clients" in result.stdout
    record = {name: entry["value"] for name, entry in json.loads(figures.read_text()).items()}
    assert record.keys() == {
        f"overhead_{name}{figure}_ms" for name in ("", "sdk_") for figure in ("median", "p99")
    }
    assert 0 < record["overhead_median_ms"] <= record["overhead_p99_ms"]
