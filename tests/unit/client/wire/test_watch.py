"""When the camera looks, as it is written and as it is sent."""

from __future__ import annotations

from datetime import time

import pytest
from pydantic import ValidationError

from veilcam_client.wire.watch import (
    FASTEST,
    SLOWEST,
    WATCH_POLICY,
    OnRequest,
    QuietHours,
    Watching,
    WatchOff,
    parse_hours,
    parse_rate,
)

NIGHT = QuietHours(begin="22:00", end="07:00")


@pytest.mark.parametrize(
    ("text", "rate"),
    [
        *(("2/s", 2.0), ("0.5/s", 0.5), ("10/s", FASTEST), ("30/min", 0.5)),
        *(("600/min", FASTEST), ("6/h", 1 / 600), ("1/h", SLOWEST)),
    ],
)
def test_rate_is_a_number_in_a_time(text: str, rate: float) -> None:
    assert parse_rate(text) == pytest.approx(rate, rel=1e-12)
    assert Watching(rate_hz=parse_rate(text)).rate_hz == parse_rate(text)


@pytest.mark.parametrize(
    "text",
    [
        *("", "2", "/s", "2/", "2 / s", " 2/s", "2/s ", "2/s\n", "-2/s", "+2/s", "2e0/s", "2,0/s"),
        *("0/s", "0.000/s", "10.001/s", "11/s", "601/min", "0.999/h", "2/d", "2/sec", "2/S"),
        *("nan/s", "inf/s", "٢/s", "1.2345/s", "20000/h", ".5/s", "2./s"),
    ],
)
def test_invalid_rate_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is no rate: use 2/s"):
        parse_rate(text)


@pytest.mark.parametrize(
    ("text", "hours"),
    [
        ("22-7", NIGHT),
        ("22:00-07:00", NIGHT),
        ("22:00-7", NIGHT),
        ("0-23:59", QuietHours(begin="00:00", end="23:59")),
        ("9:30-17:05", QuietHours(begin="09:30", end="17:05")),
    ],
)
def test_hours_are_two_times_of_day(text: str, hours: QuietHours) -> None:
    assert parse_hours(text) == hours


@pytest.mark.parametrize(
    "text",
    [
        *("", "22", "22-", "-7", "22-24", "24-7", "22:60-7", "22:5-7", "22 - 7", "22-7\n"),
        "22-7-8",
        *("7-7", "07:00-7", "2200-0700", "٢-7", "22:00:00-7"),
    ],
)
def test_invalid_hours_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"are no hours: use 22-7|is no time at all"):
        parse_hours(text)


@pytest.mark.parametrize(
    ("hours", "inside", "outside"),
    [
        (NIGHT, ("22:00", "23:59", "00:00", "06:59"), ("07:00", "12:00", "21:59")),
        (QuietHours(begin="09:00", end="17:00"), ("09:00", "16:59"), ("17:00", "23:00", "08:59")),
    ],
)
def test_hours_may_go_over_midnight_and_leave_their_end_out(
    hours: QuietHours, inside: tuple[str, ...], outside: tuple[str, ...]
) -> None:
    assert all(hours.include(time.fromisoformat(each)) for each in inside)
    assert not any(hours.include(time.fromisoformat(each)) for each in outside)


def test_policies_survive_the_wire() -> None:
    watching = Watching(rate_hz=2.0, quiet=NIGHT)
    for policy in (WatchOff(), OnRequest(), OnRequest(quiet=NIGHT), watching):
        assert WATCH_POLICY.validate_json(policy.model_dump_json()) == policy


@pytest.mark.parametrize(
    "text",
    [
        '{"mode": "watching"}',
        '{"mode": "watching", "rate_hz": 0}',
        '{"mode": "watching", "rate_hz": 10.1}',
        '{"mode": "watching", "rate_hz": "2/s"}',
        '{"mode": "off", "quiet": {"begin": "22:00", "end": "07:00"}}',
        '{"mode": "on_request", "quiet": {"begin": "22", "end": "07:00"}}',
        '{"mode": "on_request", "quiet": {"begin": "07:00", "end": "07:00"}}',
        '{"mode": "sometimes"}',
    ],
)
def test_impossible_watch_policy_is_refused(text: str) -> None:
    with pytest.raises(ValidationError):
        WATCH_POLICY.validate_json(text)
