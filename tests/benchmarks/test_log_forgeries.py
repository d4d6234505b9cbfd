"""The campaign of forged records: none is missed, and each kind finds the door left open."""

from __future__ import annotations

from typing import Any

import pytest
from benchmarks.privacy.log_forgeries import Campaign, forgeries

from veilcam_client.keys import log


@pytest.mark.slow
def test_forgeries_are_found_and_whole_logs_are_taken() -> None:
    assert forgeries(600, seed=2) == (0, 0)


@pytest.mark.parametrize(
    ("door", "kind"),
    [("_line_fault", "flipped"), ("_order_fault", "dropped"), ("_order_fault", "swapped")],
)
def test_forgeries_find_a_door_left_open(
    monkeypatch: pytest.MonkeyPatch, door: str, kind: str
) -> None:
    def nothing(*_: Any) -> None:
        return

    monkeypatch.setattr(log, door, nothing)
    campaign = Campaign(seed=3)
    lines = campaign.log(4)
    assert any(campaign.missed(kind, lines) for _ in range(50))
