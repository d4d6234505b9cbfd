"""A siege: every row, one after the other, each with its verdict."""

from __future__ import annotations

import asyncio
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tests.siege import damage, faults, greedy, kill, pages, starving
from tests.siege.daemon import Launcher
from tests.siege.ground import Extent, Ground, Judgement, Run

from veilcam_server.errors import StartError

ROWS: Mapping[str, Run] = {
    "page": pages.foreign_page,
    "sockets": starving.dribbling,
    "sockets-tls": partial(starving.dribbling, tls=True),
    "sockets-spread": partial(starving.dribbling, sources=starving.SPREAD),
    "streams": starving.greed,
    "upload": starving.stalled_upload,
    "keys": starving.repeated_keys,
    "state": damage.damaged_state,
    "disk-start": faults.full_at_start,
    "disk-later": faults.full_later,
    "log": faults.full_log,
    "clock": faults.clock_back,
    "device": faults.device_gone,
    "greedy": greedy.greedy,
    "kill": kill.killed,
}
"""By name, in the order in which they are run."""

MEASURES = ("siege_status_p99_ms", "siege_log_bytes_per_s", "siege_rss_growth_mb")
"""Figures that are no counts."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What came of one row, after so many seconds."""

    row: str
    judgement: Judgement
    seconds: float


def besiege(
    serve: str,
    extent: Extent,
    rows: Sequence[str] = tuple(ROWS),
    advance: Callable[[str, float], None] = lambda *_: None,
) -> Iterator[Verdict]:
    """Yield the verdict of each row as it is there.

    Args:
        serve: name of what the daemon under siege runs, ``module:function``.
        extent: how much there is of each attack.
        rows: names out of ``ROWS``.
        advance: told the row, and the share of it that is done.
    """
    with tempfile.TemporaryDirectory(prefix="veilcam-siege-") as folder:
        launcher = Launcher(serve, Path(folder).resolve())
        for name in rows:
            advance(name, 0.0)
            judgement, began = Judgement(), time.monotonic()
            ground = Ground(launcher, extent, partial(advance, name))
            try:
                asyncio.run(_run(ROWS[name], ground, judgement))
            except StartError as error:
                judgement.holds(f"the daemon starts: {error}", true=False)
            except Exception as error:
                # A row that breaks has not passed; the others are tried all the same.
                judgement.holds(f"the row comes to its end: {error!r}", true=False)
            yield Verdict(name, judgement, time.monotonic() - began)


async def _run(row: Run, ground: Ground, judgement: Judgement) -> None:
    await row(ground, judgement)


def figures_of(verdicts: Sequence[Verdict]) -> dict[str, float]:
    """All figures by name: of a measure the worst, of what is counted the sum."""
    found: dict[str, float] = {}
    for verdict in verdicts:
        for name, value in verdict.judgement.figures.items():
            before = found.get(name, 0.0)
            found[name] = max(before, value) if name in MEASURES else before + value
    return found
