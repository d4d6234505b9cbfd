"""Every row fails where its attack succeeds, and says what it missed."""

from __future__ import annotations

import pytest
from tests.siege import careless
from tests.siege.ground import Extent
from tests.siege.run import ROWS, besiege

TINY = Extent(
    sockets=6, seconds=1.0, lingering=1.0, streams=8, clients=4, flips=1, kills=1, gone=0.0
)
MISSED = {
    "page": ["requests of a page act"],
    "sockets": ["left of"],
    "sockets-tls": ["captures answered", "status p99"],
    "sockets-spread": ["left of"],
    "streams": ["streams of others that hear"],
    "upload": ["another uploads", "is dropped"],
    "keys": ["the same capture", "done_before_restart"],
    "state": [
        *("starts refused", "silent roll-backs", "epochs shown again"),
        "embeddings beyond the budget",
    ],
    "disk-start": ["status is answered while the disk is full", "every task goes on"],
    "disk-later": ["while the disk is full: ready", "every task goes on"],
    "log": ["every task goes on"],
    "clock": ["again of"],
    "device": ["while the sensor is gone: ready", "while the panel is gone: ready"],
    "greedy": ["white embeddings behind one mask", "raw embeddings behind one mask"],
    "kill": ["acknowledged and lost", "again of", "not opened"],
}


@pytest.mark.slow
@pytest.mark.parametrize("row", ROWS)
def test_a_daemon_that_withstands_nothing_fails(row: str) -> None:
    [verdict] = besiege(careless.NAME, TINY, [row])
    judgement = verdict.judgement
    if judgement.outcome == "untried":
        pytest.skip(str(judgement.untried))
    assert judgement.outcome == "failed"
    for what in MISSED[row]:
        assert any(what in missed for missed in judgement.missed), judgement.missed
