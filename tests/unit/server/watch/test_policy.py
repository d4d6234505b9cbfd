"""When the camera looks: what was set outlives the daemon, and hours are those of the wall."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import pytest

from veilcam_client.wire.watch import OnRequest, QuietHours, Watching, WatchOff, WatchPolicy
from veilcam_server.errors import ProblemError, StorageError
from veilcam_server.watch.policy import WatchStore, resting

BERLIN = ZoneInfo("Europe/Berlin")
TWICE = Watching(rate_hz=2.0)


def test_policy_holds_until_another_setting(tmp_path: Path) -> None:
    assert WatchStore(tmp_path, OnRequest()).at_start() == OnRequest()
    WatchStore(tmp_path, OnRequest()).set(WatchOff())
    assert WatchStore(tmp_path, OnRequest()).at_start() == WatchOff()
    assert WatchStore(tmp_path, TWICE).at_start() == TWICE
    WatchStore(tmp_path, TWICE).set(OnRequest())
    assert WatchStore(tmp_path, TWICE).at_start() == OnRequest()


def test_lost_record_switches_nothing_on(tmp_path: Path) -> None:
    faults = list[ProblemError]()
    WatchStore(tmp_path, TWICE).set(WatchOff())
    for path in (tmp_path / "watch.json", tmp_path / "watch.json.copy"):
        path.write_bytes(b"damaged")
    assert WatchStore(tmp_path, TWICE, faults.append).at_start() == WatchOff()
    assert [fault.code for fault in faults] == ["state_lost"]
    assert "the camera does not look" in str(faults[0])


def test_disk_that_takes_nothing_is_told(tmp_path: Path) -> None:
    store = WatchStore(tmp_path / "gone", OnRequest())
    with pytest.raises(StorageError, match=r"watch.json cannot be .* is what it was: check the"):
        store.set(TWICE)
    with pytest.raises(StorageError, match=r"the camera is off until a restart: watch.json cannot"):
        store.set(WatchOff())


def at(text: str) -> datetime:
    return datetime.fromisoformat(text).replace(tzinfo=BERLIN)


NIGHT = QuietHours(begin="22:00", end="07:00")


@pytest.mark.parametrize(
    ("policy", "now", "reason"),
    [
        (WatchOff(), "2026-06-01T12:00", "the camera is switched off"),
        (TWICE, "2026-06-01T23:00", None),
        (OnRequest(), "2026-06-01T23:00", None),
        (OnRequest(quiet=NIGHT), "2026-06-01T21:59:59", None),
        (OnRequest(quiet=NIGHT), "2026-06-01T22:00", "does not look between 22:00 and 07:00"),
        (Watching(rate_hz=2.0, quiet=NIGHT), "2026-06-02T06:59:59", "between 22:00 and 07:00"),
        (Watching(rate_hz=2.0, quiet=NIGHT), "2026-06-02T07:00", None),
    ],
)
def test_why_the_panel_is_opaque(policy: WatchPolicy, now: str, reason: str | None) -> None:
    found = resting(policy, at(now))
    assert (found is None) if reason is None else (found is not None and reason in found)


def quiet_minutes(hours: QuietHours, begin: datetime, minutes: int) -> list[str]:
    """Local times, with their offsets, of the minutes that are quiet."""
    policy = OnRequest(quiet=hours)
    times = [
        (begin.astimezone(UTC) + timedelta(minutes=minute)).astimezone(BERLIN)
        for minute in range(minutes)
    ]
    return [f"{now:%H:%M%z}" for now in times if resting(policy, now) is not None]


def test_hour_that_spring_leaves_out_is_no_time_to_wait_for() -> None:
    """29 March 2026: after 01:59 comes 03:00."""
    begins_inside = quiet_minutes(
        QuietHours(begin="02:30", end="03:05"), at("2026-03-29T01:30"), 120
    )
    assert begins_inside == [f"03:0{minute}+0200" for minute in range(5)]
    ends_inside = quiet_minutes(QuietHours(begin="01:57", end="02:30"), at("2026-03-29T01:30"), 120)
    assert ends_inside == ["01:57+0100", "01:58+0100", "01:59+0100"]


def test_hour_that_autumn_has_twice_is_quiet_both_times() -> None:
    """25 October 2026: after 02:59 comes 02:00 again."""
    found = quiet_minutes(QuietHours(begin="02:57", end="03:00"), at("2026-10-25T01:30"), 240)
    assert found == [f"02:{minute}{zone}" for zone in ("+0200", "+0100") for minute in (57, 58, 59)]
    assert len(quiet_minutes(NIGHT, at("2026-10-24T20:00"), 24 * 60)) == 10 * 60
    assert len(quiet_minutes(NIGHT, at("2026-03-28T20:00"), 24 * 60)) == 8 * 60
