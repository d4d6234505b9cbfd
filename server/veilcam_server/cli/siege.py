"""``veilcamd siege``: attackers and faults against a simulated daemon of one's own."""

from __future__ import annotations

import json as encoder
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from veilcam_server.cli.terminal import JsonOption, fail

if TYPE_CHECKING:
    from rich.table import Table

    from veilcam_server.siege.run import Verdict


SERVE = "veilcam_server.daemon:serve"
"""What the daemon under siege runs: siege itself lies below it, and starts it by its name."""
_SIGNS = {"passed": ("ok", "green"), "failed": ("FAIL", "bold red"), "untried": ("-", "yellow")}


def siege(
    *,
    short: Annotated[
        bool, typer.Option("--short", help="Seconds of each attack, not minutes.")
    ] = False,
    only: Annotated[
        list[str] | None, typer.Option(help="Only this row; give it several times for several.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Attack a simulated daemon of one's own on this machine, and say what it withstood.

    It runs in a temporary directory and on loopback; a daemon that serves here is left alone. Ends
    with 0 if every row passed.
    """
    # Imported late: --help need not wait for them.
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import (  # noqa: PLC0415
        BarColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
    )

    from veilcam_server.siege.ground import SHORT, Extent  # noqa: PLC0415
    from veilcam_server.siege.run import ROWS, besiege, figures_of  # noqa: PLC0415
    from veilcam_server.system import logs  # noqa: PLC0415

    logs.configure("error")  # of this process; daemons have logs of their own
    unknown = set(only or ()) - set(ROWS)
    if unknown:
        fail(f"--only {min(unknown)}: rows are {', '.join(ROWS)}")
    rows = only or tuple(ROWS)
    verdicts: list[Verdict] = []
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    ) as progress:
        task = progress.add_task("", total=len(rows))

        def advance(row: str, share: float) -> None:
            progress.update(task, description=row, completed=len(verdicts) + share)

        for verdict in besiege(SERVE, SHORT if short else Extent(), rows, advance):
            verdicts.append(verdict)  # noqa: PERF402 - the progress counts them
    if json:
        rows_done = [_summary(verdict) for verdict in verdicts]
        typer.echo(encoder.dumps({"rows": rows_done, "figures": figures_of(verdicts)}, indent=1))
    else:
        Console().print(_table(verdicts))
    raise SystemExit(any(verdict.judgement.outcome == "failed" for verdict in verdicts))


def _summary(verdict: Verdict) -> dict[str, object]:
    judgement = verdict.judgement
    return {
        "row": verdict.row,
        "outcome": judgement.outcome,
        "seconds": round(verdict.seconds, 1),
        "found": judgement.found,
        "missed": judgement.missed,
        "untried": judgement.untried,
    }


def _table(verdicts: Sequence[Verdict]) -> Table:
    from rich.table import Table  # noqa: PLC0415 - late, as above
    from rich.text import Text  # noqa: PLC0415

    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    for verdict in verdicts:
        judgement = verdict.judgement
        sign, style = _SIGNS[judgement.outcome]
        table.add_row(Text(sign, style), verdict.row, Text(f"{verdict.seconds:.0f} s"), "")
        if judgement.untried is not None:
            table.add_row("", "", "", Text(judgement.untried, style))
        for part in judgement.found:
            table.add_row("", "", "", Text(part, "bold red" if part in judgement.missed else ""))
    return table
