"""Benchmarks of the daemon, made short; and that they would notice a failure."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import pytest
from benchmarks.daemon import demo, overhead, sse
from benchmarks.people.zone import seen_after
from rich.console import Console
from tests.benchmarks.conftest import figures_of

from veilcam_client.wire.captures import Timing
from veilcam_client.wire.events import Event, Gap, MaskChanged
from veilcam_server.demo.run import Plan
from veilcam_server.demo.tally import Sample, Tally


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
    record = figures_of(figures)
    assert record.keys() == {
        f"overhead_{name}{figure}_ms" for name in ("", "sdk_") for figure in ("median", "p99")
    }
    assert 0 < record["overhead_median_ms"] <= record["overhead_p99_ms"]


NOW = datetime.now(UTC)


def mask(place: int) -> Event:
    return MaskChanged(id=f"boot-{place}", at=NOW, epoch="e")


def gap(place: int, missed: int | None) -> Event:
    return Gap(id=f"boot-{place}", at=NOW, missed=missed)


@pytest.mark.parametrize(
    ("events", "told", "silent", "repeated"),
    [
        ([mask(3), mask(4), mask(5)], 0, 0, 0),
        ([mask(3), mask(6)], 0, 2, 0),
        ([mask(3), mask(4), mask(4), mask(5)], 0, 0, 1),
        ([mask(3), mask(5), mask(4)], 0, 1, 1),
        ([mask(3), gap(7, 4), mask(8)], 4, 0, 0),
        ([mask(3), gap(7, 2), mask(8)], 2, 2, 0),
        ([mask(3), gap(7, 4), mask(9)], 4, 1, 0),
    ],
)
def test_missed_and_repeated_events_are_counted(
    events: list[Event], told: int, silent: int, repeated: int
) -> None:
    heard = sse.Heard()
    for event in events:
        heard.hear(event)
    assert (heard.told, heard.silent, heard.repeated) == (told, silent, repeated)
    whole = sse.Heard()
    for place in range(3, 10):
        whole.hear(mask(place))
    assert sse.missing([whole]) == 0
    assert sse.missing([whole, heard]) >= told + silent + repeated


def test_listener_that_never_heard_the_end_is_counted() -> None:
    first, second = sse.Heard(), sse.Heard()
    for place in range(5):
        first.hear(mask(place))
    second.hear(mask(0))
    assert sse.missing([first, second]) == 1


@pytest.mark.slow
def test_listeners_of_a_daemon_miss_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = tmp_path / "figures.json"
    sse.main(listeners=6, seconds=0.5, figures=figures)
    assert "who did not read: 0 missed" in capsys.readouterr().out
    assert json.loads(figures.read_text())["sse_gaps"]["value"] == 0


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
