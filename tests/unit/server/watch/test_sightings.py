"""Sightings: few events of many captures."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from tests.unit.server.watch.conftest import LABELS, Look

from veilcam_server.masks.source import Evidence
from veilcam_server.watch.belief import Dynamics, Thresholds
from veilcam_server.watch.sightings import GONE, Change, Fusion


def run(
    fusion: Fusion, looks: Iterable[Evidence], *, begin: float = 0.0
) -> list[tuple[float, Change]]:
    """Changes with their times, at two looks a second."""
    return [
        (begin + 0.5 * number, change)
        for number, evidence in enumerate(looks)
        for change in fusion.take(evidence, begin + 0.5 * number)
    ]


@pytest.fixture
def fusion() -> Fusion:
    return Fusion(Thresholds(), Dynamics(), 4)


def told(changes: list[tuple[float, Change]]) -> list[tuple[float, str, str, float]]:
    return [(at, each.kind, each.label, each.duration) for at, each in changes]


def test_thing_is_told_of_once_when_it_comes_and_once_when_it_goes(
    fusion: Fusion, look: Look
) -> None:
    seen = [*4 * [None], *20 * ["a"], *10 * [None]]
    changes = run(fusion, map(look, seen))
    # The second look that sees it tells, and so does the second that does not.
    assert told(changes) == [(2.5, "seen", "a", 0.5), (12.5, "gone", "a", 10.0)]
    sure = [change.confidence for _, change in changes]
    assert sure[0] is not None
    assert sure[1] is not None
    assert Thresholds().seen <= sure[0] < 1
    assert 1 - GONE <= sure[1] < 1


@pytest.mark.parametrize(("threshold", "at"), [(0.6, 2.5), (0.98, 3.0)])
def test_thing_is_told_of_from_the_threshold_on(look: Look, threshold: float, at: float) -> None:
    fusion = Fusion(Thresholds(seen=threshold), Dynamics(), 4)
    [(when, change)] = run(fusion, map(look, [*4 * [None], *20 * ["a"]]))
    assert change.confidence is not None
    assert change.confidence >= threshold
    assert when == at


def test_thing_for_another_is_one_that_goes_and_one_that_comes(fusion: Fusion, look: Look) -> None:
    changes = run(fusion, map(look, [None, *6 * ["a"], *6 * ["c"]]))
    kinds = [(change.kind, change.label) for _, change in changes]
    assert kinds == [("seen", "a"), ("gone", "a"), ("seen", "c")]


@pytest.mark.parametrize("blink", ["b", None])
def test_one_look_that_sees_something_else_changes_nothing(
    fusion: Fusion, look: Look, blink: str | None
) -> None:
    assert len(run(fusion, map(look, 4 * ["a"]))) == 1
    assert run(fusion, map(look, [blink, *4 * ["a"]]), begin=2.0) == []
    assert run(Fusion(Thresholds(), Dynamics(), 4), map(look, [*4 * [None], "b", None])) == []


def test_look_like_no_thing_is_nothing_however_sure_the_classifier(
    fusion: Fusion, look: Look
) -> None:
    assert run(fusion, 50 * [look("a", novelty=50.0)]) == []
    assert run(fusion, 50 * [look("a", light=0.0)], begin=25.0) == []
    assert fusion.leader is not None
    assert (fusion.leader.label, fusion.leader.looks) == (None, 100)


def test_fusion_that_stops_looking_believes_nothing(fusion: Fusion, look: Look) -> None:
    run(fusion, map(look, 6 * ["a"]))
    [change] = fusion.stop()
    assert change == Change("gone", "a", None, 2.5)
    leaders = [fusion.leader]
    assert fusion.stop() == []
    # What was believed then tells nothing of later.
    fusion.take(look("b"), 3.0)
    leaders.append(fusion.leader)
    assert leaders[0] is None
    assert leaders[1] is not None
    assert (leaders[1].label, leaders[1].looks, leaders[1].since) == ("b", 1, 3.0)


def test_classes_of_another_bundle_begin_anew(fusion: Fusion, look: Look) -> None:
    run(fusion, map(look, 6 * ["a"]))
    other = Evidence(("x", "y"), (6.0, 0.0), 0.02, 1.0)
    changes = run(fusion, 4 * [other], begin=3.0)
    assert [(change.kind, change.label) for _, change in changes] == [("gone", "a"), ("seen", "x")]


def test_bundle_without_statistics_of_scenes_is_believed_less(look: Look) -> None:
    confidences = []
    for novelty in (1.0, None):
        fusion = Fusion(Thresholds(), Dynamics(), 4)
        run(fusion, 6 * [look("a", novelty=novelty)])
        assert fusion.leader is not None
        confidences.append(fusion.leader.confidence)
    assert confidences[0] > confidences[1] > Thresholds().seen


def test_history_is_the_last_sights_newest_first(fusion: Fusion, look: Look) -> None:
    for number in range(9):
        run(fusion, map(look, [*4 * [LABELS[number % 3]], *4 * [None]]), begin=4.0 * number)
    run(fusion, map(look, 4 * ["b"]), begin=36.0)
    history = fusion.history
    assert [sight.label for sight in history] == ["b", "c", "b", "a"]
    assert [sight.since for sight in history] == [36.0, 32.0, 28.0, 24.0]
    assert [sight.until for sight in history] == [None, 34.0, 30.0, 26.0]
    assert all(sight.confidence > Thresholds().seen for sight in history)


def test_slow_looks_forget_in_between(fusion: Fusion, look: Look) -> None:
    run(fusion, map(look, 4 * ["a"]))
    # An hour later anything may be there: one look is believed as the first of all was.
    fusion.take(look("b"), 3600.0)
    assert fusion.leader is not None
    later = fusion.leader.confidence
    fresh = Fusion(Thresholds(), Dynamics(), 4)
    fresh.take(look("b"), 0.0)
    assert fresh.leader is not None
    assert later == pytest.approx(fresh.leader.confidence)
