"""When a mask must change, and how often it may serve beyond that."""

from __future__ import annotations

import math

import pytest

from veilcam_client.wire.rotation import EveryCaptures, EverySeconds, RotationOff, RotationPolicy
from veilcam_server.camera.capture import ActiveMask, Lateness, due_in, reusable
from veilcam_server.camera.epochs import Epoch


@pytest.mark.parametrize(
    ("chance", "shown_for", "expected"),
    [
        (0.0, 0.0, 8.0),  # no jitter drawn: all of its time
        (0.5, 0.0, 6.0),
        (0.5, 1.0, 5.0),
        (0.25, 6.5, 0.5),
        (0.25, 7.0, 0.0),
        (0.25, 7.5, 0.0),  # overdue is due, not less than that
    ],
)
def test_mask_s_time_is_the_period_less_its_jitter_less_what_has_passed(
    chance: float, shown_for: float, expected: float
) -> None:
    policy = EverySeconds(seconds=8.0, jitter=4.0)
    assert due_in(policy, shown_for=shown_for, captures=10**6, chance=chance) == expected


def test_without_jitter_chance_changes_nothing() -> None:
    policy = EverySeconds(seconds=8.0)
    assert due_in(policy, shown_for=1.0, captures=0, chance=0.9) == 7.0


@pytest.mark.parametrize(
    ("captures", "expected"), [(0, math.inf), (2, math.inf), (3, 0.0), (4, 0.0)]
)
def test_mask_serves_as_many_captures_as_asked_for(captures: int, expected: float) -> None:
    policy = EveryCaptures(captures=3)
    assert due_in(policy, shown_for=1e9, captures=captures, chance=0.5) == expected


def test_mask_stays_for_ever_where_rotation_is_off() -> None:
    assert due_in(RotationOff(), shown_for=1e9, captures=10**9, chance=0.5) == math.inf


@pytest.mark.parametrize(
    ("policy", "captures"),
    [
        (RotationOff(), 0),
        (EverySeconds(seconds=8.0), 0),
        (EverySeconds(seconds=8.0, reuse=5), 5),
        (EveryCaptures(captures=3), 0),
        (EveryCaptures(captures=3, reuse=2), 2),
    ],
)
def test_captures_beyond_what_is_due(policy: RotationPolicy, captures: int) -> None:
    assert reusable(policy) == captures


def make_active() -> ActiveMask:
    epoch = Epoch("a", object(), "none", "", object())  # type: ignore[arg-type]
    return ActiveMask(epoch, since=0.0, completed_at=0.0)


def test_mask_that_is_due_serves_as_often_as_allowed_and_each_time_counts() -> None:
    active, lateness = make_active(), Lateness()
    assert (lateness.late, lateness.reused) == (0, 0)
    assert [active.reuse(2, lateness) for _ in range(4)] == [True, True, False, False]
    assert (active.overdue, lateness.late, lateness.reused) == (2, 1, 2)
    assert make_active().reuse(0, lateness) is False
    assert (lateness.late, lateness.reused) == (2, 2)


def test_neither_masks_nor_what_reads_them_show_themselves() -> None:
    secret = "0123456789"
    epoch = Epoch("a", secret, "sealed", "", secret, secret)  # type: ignore[arg-type]
    assert secret not in repr(epoch)
    assert secret not in repr(ActiveMask(epoch, 0.0, 0.0))
