"""Rows in their quick form: the daemon withstands them, and one that withstands nothing fails."""

from __future__ import annotations

import pytest
import typer
from tests.siege import __main__ as siege
from tests.siege import careless
from tests.siege.__main__ import ATTACKS, ROWS, Verdict, besiege, figures_of
from tests.siege.ground import QUICK, SERVE, Extent, Ground, Judgement
from typer.testing import CliRunner

TINY = Extent(
    sockets=6, seconds=1.0, lingering=1.0, streams=8, clients=4, flips=1, kills=1, gone=0.0
)
TOGETHER = ("sockets", "sockets-spread", "streams", "upload")
MISSED = {
    "sockets": ["left of"],
    "sockets-tls": ["it speaks TLS", "left of"],
    "sockets-spread": ["left of"],
    "streams": ["streams of others that hear"],
    "upload": ["another uploads", "is dropped"],
    "keys": ["the same capture", "answer_lost"],
    "state": [
        *("starts refused", "silent roll-backs", "epochs shown again"),
        "embeddings beyond the budget",
    ],
    "disk-start": ["status is answered while the disk is full", "every task goes on"],
    "disk-later": ["while the disk is full: ready", "every task goes on"],
    "log": ["every task goes on"],
    "clock": ["again of"],
    "device": ["while the sensor is gone: ready", "while the panel is gone: ready"],
    "greedy": ["embeddings behind one drawn mask", "embeddings behind one stored mask"],
    "kill": ["acknowledged and lost", "again of", "not opened"],
}


@pytest.mark.slow
@pytest.mark.parametrize("rows", [TOGETHER, *((row,) for row in ROWS if row not in TOGETHER)])
def test_daemon_withstands(rows: tuple[str, ...]) -> None:
    verdicts = list(besiege(SERVE, QUICK, rows))
    # How long an answer took depends on what else this machine does; the long form measures it.
    missed = [part for each in verdicts for part in each.judgement.missed if "[ms]" not in part]
    assert missed == []
    if untried := [each.judgement.untried for each in verdicts if each.judgement.untried]:
        pytest.skip(str(untried))


@pytest.mark.slow
@pytest.mark.parametrize("row", ATTACKS)
def test_daemon_that_withstands_nothing_fails(row: str) -> None:
    [verdict] = besiege(careless.NAME, TINY, [row])
    judgement = verdict.judgement
    if judgement.outcome == "untried":
        pytest.skip(str(judgement.untried))
    assert judgement.outcome == "failed"
    for what in MISSED[row]:
        assert any(what in missed for missed in judgement.missed), judgement.missed


async def _holds(ground: Ground, judgement: Judgement) -> None:
    judgement.at_most("lost", 0, 0, figure="kills_lost")
    judgement.at_least("captures", 99.5, 99)


async def _breaks(_: Ground, __: Judgement) -> None:
    raise KeyError("state")


async def _misses(_: Ground, judgement: Judgement) -> None:
    judgement.at_most("memory", 51, 50)
    judgement.at_least("answered", 98, 99)
    judgement.none("leaks", ["one", "one", "two"], "fuzz_leaks")
    judgement.holds("it lives", true=False)


async def _lacks(_: Ground, judgement: Judgement) -> None:
    judgement.untried = "no disk of one's own"


def test_row_that_misses_a_bar_or_breaks_is_the_status(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = {"holds": _holds, "breaks": _breaks, "misses": _misses, "lacks": _lacks}
    monkeypatch.setattr(siege, "ROWS", rows)
    verdicts = list(besiege("none:serve", QUICK, tuple(rows)))
    judged = [each.judgement for each in verdicts]
    assert [each.outcome for each in judged] == ["passed", "failed", "failed", "untried"]
    assert "KeyError" in judged[1].missed[0]
    assert judged[2].missed == judged[2].found
    assert len(judged[2].found) == 4
    assert figures_of(verdicts) == {"kills_lost": 0, "fuzz_leaks": 3}
    for asked, status in (("holds", 0), ("lacks", 0), ("misses", 1), ("breaks", 1), ("moon", 2)):
        app = typer.Typer()
        app.command()(siege.main)
        assert CliRunner().invoke(app, [asked, "--quick"]).exit_code == status


def test_figures_are_the_worst_of_measures_and_the_sum_of_counts() -> None:
    found = [{"siege_status_p99_ms": 7.0, "kills": 1.0}, {"siege_status_p99_ms": 5.0, "kills": 2.0}]
    verdicts = [Verdict("a", Judgement(figures=figures), 0.0) for figures in found]
    assert figures_of(verdicts) == {"siege_status_p99_ms": 7.0, "kills": 3.0}
