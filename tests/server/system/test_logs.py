"""How often a line is written."""

from __future__ import annotations

from veilcam_server.system.logs import Throttle


def test_a_line_a_minute_stands_for_all_that_came() -> None:
    clock = [100.0]
    throttle = Throttle(60.0, now=lambda: clock[0])
    assert throttle.due() == 1
    for clock[0] in (101.0, 130.0, 159.9):
        assert throttle.due() is None
    clock[0] = 160.0
    assert throttle.due() == 4
    assert throttle.due() is None
    clock[0] = 1000.0
    assert throttle.due() == 2
