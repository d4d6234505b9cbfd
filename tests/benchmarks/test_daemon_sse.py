"""The benchmark of the event stream, made short; and that it would notice a failure."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from benchmarks.daemon import sse

from veilcam_client.wire.events import Event, Gap, MaskChanged

if TYPE_CHECKING:
    pass

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
