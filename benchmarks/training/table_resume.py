"""Does a table that is killed end with the same numbers as one that is not?

A part of the MNIST table is run by ``benchmarks.paper`` in a process of its own, which is killed
with SIGKILL in the middle of every cell and started again; then the same part is run unbroken into
another folder. All numbers, confusion matrices, masks and weights must be equal, bit by bit.

    python -m benchmarks.training.table_resume --data data/mnist \
        --figures benchmarks/results/training.json
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.paper.results import BUNDLE, CHECKPOINT, RESULT, load_results

from veilcam_training.bundle import read_bundle

PART = (
    *("--encoders", "learned"),
    *("--classifiers", "LR,FC800"),
    *("--embeddings", "3x4"),
    *("--binnings", "area"),
)


def main(
    *,
    data: Annotated[Path, typer.Option(help="Folder with MNIST's four idx files.")],
    epochs: Annotated[int, typer.Option(min=2)] = 4,
    figures: FiguresOption = None,
) -> None:
    """Run it both ways and compare."""
    with tempfile.TemporaryDirectory() as folder:
        broken, whole = Path(folder) / "broken", Path(folder) / "whole"
        options = [*PART, "--data", str(data), "--epochs", str(epochs)]
        kills = 0
        while run_until_checkpoint([*options, "--work", str(broken)], broken):
            kills += 1
        run([*options, "--work", str(whole)]).wait()
        same = cells(broken) == cells(whole) and bundles(broken, whole)
        print(f"{kills} kills in {len(cells(whole))} cells: {'the same' if same else 'DIFFERENT'}")
    if kills == 0:
        raise SystemExit("no cell could be killed before it was finished: use more epochs")
    record(figures, {"resume_identical": float(same)})


def run(options: list[str]) -> subprocess.Popen[bytes]:
    """Start the command."""
    return subprocess.Popen([sys.executable, "-m", "benchmarks.paper", "mnist", *options])


def run_until_checkpoint(options: list[str], work: Path) -> bool:
    """Kill the command in the first cell that has not been broken yet; False if it ended itself."""
    known = set(work.glob(f"*/{CHECKPOINT}")) | {
        path.with_name(CHECKPOINT) for path in work.glob(f"*/{RESULT}")
    }
    process = run(options)
    while process.poll() is None:
        if set(work.glob(f"*/{CHECKPOINT}")) - known:
            process.kill()
            process.wait()
            return True
        time.sleep(0.01)
    if process.returncode:
        raise SystemExit(process.returncode)
    return False


def cells(work: Path) -> list[dict[str, object]]:
    """The numbers of every finished cell."""
    return [result.numbers() for result in load_results(work)]


def bundles(first: Path, second: Path) -> bool:
    """True if both have the same masks and weights."""
    paths = [sorted(work.glob(f"*/{BUNDLE}")) for work in (first, second)]
    if [path.parent.name for path in paths[0]] != [path.parent.name for path in paths[1]]:
        return False
    for one, other in zip(*paths, strict=True):
        pairs = [read_bundle(path).pairs[0] for path in (one, other)]
        if (pairs[0].levels != pairs[1].levels).any():
            return False
        if any(
            not np.array_equal(pairs[0].weights[k], pairs[1].weights[k]) for k in pairs[0].weights
        ):
            return False
    return True


if __name__ == "__main__":
    typer.run(main)
