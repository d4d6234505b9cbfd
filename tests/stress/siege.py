"""``veilcamd siege`` in its long form, and the figures of it.

    python -m tests.stress.siege --figures benchmarks/results/siege.json

How many epochs were repeated stands beside the other figures of keys, too:

    python -m tests.stress.siege --only kill --keys benchmarks/results/keys.json
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer
from benchmarks.figures import FiguresOption, record

OF_KEYS = "epochs_repeated"
"""Figure that tells of keys."""


def main(
    *,
    short: Annotated[bool, typer.Option("--short", help="Seconds of each attack.")] = False,
    only: Annotated[list[str] | None, typer.Option(help="Only this row; or several.")] = None,
    figures: FiguresOption = None,
    keys: Annotated[Path | None, typer.Option(help=f"Record to write {OF_KEYS} into, too.")] = None,
) -> None:
    """Run it, say what each row came to, and record its figures."""
    rows = [argument for row in only or () for argument in ("--only", row)]
    command = [sys.executable, "-m", "veilcam_server", "siege", "--json"]
    command += [*(("--short",) if short else ()), *rows]
    # Its progress goes to the terminal.
    ended = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    found = json.loads(ended.stdout)
    for row in found["rows"]:
        print(f"{row['outcome']:8} {row['row']} ({row['seconds']:.0f} s)")
        for part in row["found"]:
            print(f"         {part}")
    record(figures, found["figures"])
    record(keys, {name: value for name, value in found["figures"].items() if name == OF_KEYS})
    raise SystemExit(ended.returncode)


if __name__ == "__main__":
    typer.run(main)
