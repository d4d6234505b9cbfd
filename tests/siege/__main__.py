"""Siege of a simulated daemon: attacks, faults, fuzzers and a soak, a row each.

    python -m tests.siege --figures benchmarks/results/siege.json
    python -m tests.siege kill --keys benchmarks/results/keys.json
    python -m tests.siege api-fuzz bundle-fuzz picture-fuzz soak

Daemons run in a temporary folder and on loopback. The status is 1 if a row failed.
"""

from __future__ import annotations

import asyncio
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from benchmarks.figures import FiguresOption, record
from tests.siege import (
    api_fuzz,
    bundle_fuzz,
    damage,
    faults,
    greedy,
    kill,
    picture_fuzz,
    soak,
    starving,
)
from tests.siege.ground import QUICK, SERVE, Extent, Ground, Judgement, Run

from veilcam_server.errors import StartError
from veilcam_server.system import logs

ATTACKS: Mapping[str, Run] = {
    "sockets": starving.dribbling,
    "sockets-tls": partial(starving.dribbling, tls=True),
    "sockets-spread": partial(starving.dribbling, sources=starving.SPREAD),
    "streams": starving.greed,
    "upload": starving.stalled_upload,
    "keys": starving.repeated_keys,
    "state": damage.damaged_state,
    "disk-start": partial(faults.full_disk, at_start=True),
    "disk-later": partial(faults.full_disk, at_start=False),
    "log": faults.full_log,
    "clock": faults.clock_back,
    "device": faults.device_gone,
    "greedy": greedy.greedy,
    "kill": kill.killed,
}
STRESS: Mapping[str, Run] = {
    "api-fuzz": api_fuzz.fuzzed,
    "bundle-fuzz": bundle_fuzz.fuzzed,
    "picture-fuzz": picture_fuzz.fuzzed,
    "soak": soak.soaked,
}
ROWS = {**ATTACKS, **STRESS}
MEASURES = ("siege_status_p99_ms", "siege_log_bytes_per_s", "siege_rss_growth_mb")
OF_KEYS = "epochs_repeated"


@dataclass(frozen=True, slots=True)
class Verdict:
    row: str
    judgement: Judgement
    seconds: float


def besiege(serve: str, extent: Extent, rows: Sequence[str]) -> Iterator[Verdict]:
    with tempfile.TemporaryDirectory(prefix="veilcam-siege-") as folder, ExitStack() as stack:
        ground = Ground(serve, Path(folder).resolve(), extent, stack)
        for name in rows:
            judgement, began = Judgement(), time.monotonic()
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
    """Return all figures by name: the worst of a measure, the sum of a count."""
    found: dict[str, float] = {}
    for verdict in verdicts:
        for name, value in verdict.judgement.figures.items():
            before = found.get(name, 0.0)
            found[name] = max(before, value) if name in MEASURES else before + value
    return found


def main(
    *,
    rows: Annotated[list[str] | None, typer.Argument(help="Rows; all attacks by default.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Seconds of each row.")] = False,
    figures: FiguresOption = None,
    keys: Annotated[Path | None, typer.Option(help=f"Record of {OF_KEYS}, too.")] = None,
) -> None:
    """Run rows, print what each found, and record the figures."""
    logs.configure("error")  # of this process; daemons have logs of their own
    unknown = set(rows or ()) - set(ROWS)
    if unknown:
        raise typer.BadParameter(f"no row {min(unknown)}: rows are {', '.join(ROWS)}")
    verdicts = []
    for verdict in besiege(SERVE, QUICK if quick else Extent(), rows or tuple(ATTACKS)):
        verdicts.append(verdict)
        judgement = verdict.judgement
        print(f"{judgement.outcome:8} {verdict.row} ({verdict.seconds:.0f} s)", flush=True)
        for part in (*judgement.found, *filter(None, [judgement.untried])):
            print(f"         {part}", flush=True)
    found = figures_of(verdicts)
    record(figures, found)
    record(keys, {name: value for name, value in found.items() if name == OF_KEYS})
    raise SystemExit(any(verdict.judgement.outcome == "failed" for verdict in verdicts))


if __name__ == "__main__":
    typer.run(main)
