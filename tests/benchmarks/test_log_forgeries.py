"""The campaign of forged records: none is missed, and each kind finds the door left open."""

from __future__ import annotations

from typing import Any

import pytest
from benchmarks.privacy import log_forgeries
from benchmarks.privacy.log_forgeries import Campaign, forgeries

from veilcam_client.keys import log_check


@pytest.mark.slow
def test_no_forgery_is_missed_and_no_whole_log_refused() -> None:
    assert forgeries(600, seed=2) == (0, 0)


def test_some_logs_begin_where_the_camera_dropped_what_was_before() -> None:
    campaign = Campaign(seed=4)
    begins = [log_check.examine(log_forgeries._content(campaign.log(n)[0])).first for n in (2, 9)]
    assert begins[0] == 0
    assert begins[1]


@pytest.mark.parametrize(
    ("door", "kind"),
    [("_check_line", "flipped"), ("_check_order", "dropped"), ("_check_order", "swapped")],
)
def test_a_door_left_open_is_found(monkeypatch: pytest.MonkeyPatch, door: str, kind: str) -> None:
    def nothing(*_: Any) -> None:
        return

    monkeypatch.setattr(log_check, door, nothing)
    campaign = Campaign(seed=3)
    lines, head = campaign.log(4)
    assert any(campaign.missed(kind, lines, head) for _ in range(50))


def test_a_record_is_timed() -> None:
    assert log_forgeries.record_ms(captures=5) > 0


def test_the_newest_is_missed_without_a_head() -> None:
    lines, head = Campaign(seed=3).log(4)
    content = log_forgeries._content(lines[:-1])
    assert not log_check.examine(content).findings
    assert log_check.examine(content, head=head).findings
