"""What stands beside a head's accuracy: an interval, and what chance reads."""

from __future__ import annotations

import pytest
from benchmarks.training.heads import interval


def test_interval_is_wilsons() -> None:
    # Newcombe 1998, table I: 81 of 263 and 0 of 20, to the digits that stand there.
    assert interval(81 / 263, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert interval(0.0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)
