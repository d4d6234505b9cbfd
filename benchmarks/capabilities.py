"""Under how many kinds of instructions the whole suite passes: SSE, AVX2, and better if had.

    python -m benchmarks.capabilities --figures benchmarks/results/house.json

Each takes as long as ``make pytest``. The Makefile says what every library is told; which kind it
was is taken from torch's own answer in the header of pytest.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import torch
import typer

from benchmarks.figures import FiguresOption, record
from veilcam_training.experiments.records import check_record

ROOT = Path(__file__).resolve().parents[1]
LEVELS = ("DEFAULT", "AVX2", "AVX512")
"""What ATen calls the instructions of x86-64 that it has kernels for, the oldest first."""
TARGETS = {"DEFAULT": "suite-SSE", "AVX2": "suite-AVX2"}
"""Targets of ``make`` that hold a newer processor down to these; ``pytest`` holds nothing down."""
HEADER = re.compile(r"^torch: (\w+), ")


@dataclass(frozen=True, slots=True)
class Run:
    """The suite, run once."""

    target: str
    """Of ``make``."""
    capability: str | None
    """As torch told it; None: the run ended before."""
    passed: bool


def targets_up_to(best: str) -> tuple[str, ...]:
    """Targets of ``make`` that show all that a machine can, whose best is ``best`` of ``LEVELS``.

    Raises:
        ValueError: it is none of x86-64.
    """
    if best not in LEVELS:
        raise ValueError(f"torch runs on {best} here: use a machine with one of {LEVELS}")
    levels = LEVELS[: LEVELS.index(best) + 1]
    return tuple(TARGETS.get(level, "pytest") for level in levels)


def run(target: str, *variables: str) -> Run:
    """Make a target, with ``variables`` of make, and show what it says as it comes."""
    command = ["make", f"--directory={ROOT}", *variables, target]
    capability = None
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            print(line, end="", flush=True)
            if found := HEADER.match(line):
                capability = found[1]
    return Run(target, capability, process.returncode == 0)


def green(runs: Iterable[Run]) -> frozenset[str]:
    """Capabilities under which everything passed, every time."""
    runs = tuple(runs)
    failed = {run.capability for run in runs if not run.passed}
    return frozenset(run.capability for run in runs if run.capability) - failed


def main(figures: FiguresOption = None) -> None:
    """Run the suite under one after the other, and say under which it passed."""
    if figures is not None:
        check_record(figures)
    best = torch.backends.cpu.get_cpu_capability()
    runs = [run(target) for target in targets_up_to(best)]
    for each in runs:
        outcome = "passed" if each.passed else "failed"
        print(f"{each.target}: {each.capability or 'nothing ran'}, {outcome}")
    shown = {each.capability for each in runs}
    print(f"not shown here: {', '.join(level for level in LEVELS if level not in shown) or 'none'}")
    record(figures, {"capabilities_green": len(green(runs))})
    if not all(each.passed for each in runs):
        raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(main)
