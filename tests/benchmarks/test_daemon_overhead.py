"""The benchmark of the daemon's overhead, made short; and what it counts as overhead."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from benchmarks.daemon import overhead

from veilcam_client.wire.captures import Timing


def test_overhead_is_the_rest_of_what_the_device_took() -> None:
    timing = Timing(queue_s=0.2, rotation_s=0.1, settle_s=0.05, capture_s=0.04)
    request = overhead.Request(0.5, timing)
    assert request.device == pytest.approx(0.39)
    assert request.overhead == pytest.approx(0.11)


@pytest.mark.thorough
def test_figures_of_clients_at_the_same_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VEILCAM_RATE_LIMIT", "set again by the measurement, and put back here")
    figures = tmp_path / "figures.json"
    overhead.main(clients=2, count=3, figures=figures)
    said = capsys.readouterr().out
    assert "6 requests of 2 plain clients" in said
    assert "6 requests of 2 SDK clients" in said
    record = {name: entry["value"] for name, entry in json.loads(figures.read_text()).items()}
    assert record.keys() == {
        f"overhead_{name}{figure}_ms" for name in ("", "sdk_") for figure in ("median", "p99")
    }
    assert 0 < record["overhead_median_ms"] <= record["overhead_p99_ms"]
