"""Benchmarks of the daemon, made short; and that they would notice a failure."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from benchmarks.daemon import demo, light, overhead, sse
from benchmarks.people.zone import seen_after
from rich.console import Console
from tests.benchmarks.conftest import figures_of

from veilcam_server.demo.run import Plan
from veilcam_server.demo.tally import Sample, Tally


@pytest.mark.thorough
def test_figures_of_clients_at_the_same_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = tmp_path / "figures.json"
    overhead.main(clients=2, count=3, figures=figures)
    said = capsys.readouterr().out
    assert "6 requests of 2 plain clients" in said
    assert "6 requests of 2 SDK clients" in said
    record = figures_of(figures)
    assert record.keys() == {
        f"overhead_{name}{figure}_ms" for name in ("", "sdk_") for figure in ("median", "p99")
    }
    assert 0 < record["overhead_median_ms"] <= record["overhead_p99_ms"]


@pytest.mark.slow
def test_listeners_of_a_daemon_miss_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = tmp_path / "figures.json"
    sse.main(listeners=6, seconds=0.5, figures=figures)
    assert "who did not read: 0 missed" in capsys.readouterr().out
    assert json.loads(figures.read_text())["sse_gaps"]["value"] == 0


@pytest.mark.thorough
def test_figures_of_the_simulated_light(tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    light.main(quick=True, figures=figures)
    record = figures_of(figures)
    assert 0 < record["simulated_light_error_over_tolerance"] < 1
    assert len(record) == 4


@pytest.mark.parametrize(
    ("fresh", "wrong_classifier", "name"),
    [
        (False, False, "demo_accuracy"),
        (False, True, "demo_wrong_classifier_accuracy"),
        (True, False, "demo_fresh_accuracy"),
    ],
)
def test_accuracy_of_the_demonstration_is_recorded(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    *,
    fresh: bool,
    wrong_classifier: bool,
    name: str,
) -> None:
    plans: list[Plan] = []

    def demonstrated(plan: Plan, console: Console) -> Tally:
        plans.append(plan)
        rights = [True, False, True, True, False, True]
        return Tally([Sample("a", 0, right, settle=0, capture=0, rest=0) for right in rights])

    monkeypatch.setattr(demo, "demonstrate", demonstrated)
    figures, bundle, out = (tmp_path / each for each in ("figures.json", "a.veilcam", "out"))
    figures.write_text('{"other": {"value": 1}}')
    plan = Plan(fresh=fresh, bundle=bundle, out=out, captures=6, wrong_classifier=wrong_classifier)
    demo.main(
        fresh=fresh,
        wrong_classifier=wrong_classifier,
        bundle=bundle,
        captures=6,
        out=out,
        figures=figures,
    )
    assert plans == [plan]
    written = json.loads(figures.read_text())
    assert written["other"] == {"value": 1}
    assert set(written[name]) == {"value", "command", "commit", "date", "machine"}
    assert written[name]["value"] == 0.6667
    assert "accuracy=0.667 captures=6" in capsys.readouterr().out


@pytest.mark.thorough
def test_zone_that_changes_to_and_fro_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TZ", "UTC")
    assert len(seen_after(tmp_path, 2)) == 2
