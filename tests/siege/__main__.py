"""Siege of a simulated daemon on this machine: attackers, faults, fuzzers and a soak.

    python -m tests.siege --figures benchmarks/results/siege.json
    python -m tests.siege kill --keys benchmarks/results/keys.json

The daemon runs in a temporary folder and on loopback. The status is 1 if a row failed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from benchmarks.figures import FiguresOption, record
from tests.siege.ground import SHORT, Extent
from tests.siege.run import ROWS, besiege, figures_of

from veilcam_server.system import logs

SERVE = "veilcam_server.daemon:serve"
OF_KEYS = "epochs_repeated"
"""Figure that is recorded among those of keys, too."""


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
    for verdict in besiege(SERVE, SHORT if quick else Extent(), rows or tuple(ROWS)):
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
