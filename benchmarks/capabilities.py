"""Under how many kinds of instructions the whole suite passes: SSE, AVX2, and better if had.

    python -m benchmarks.capabilities --figures benchmarks/results/house.json

Each takes as long as ``make pytest``. The Makefile says what every library is told; which kind it
was is taken from torch's own answer in the header of pytest. The machine's best runs as ``make
test``, whose cost is recorded: on two quiet cores it is that of every merge.
"""

from __future__ import annotations

import re
import subprocess
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage

import torch
import typer

from benchmarks.figures import FiguresOption, check_record, record

ROOT = Path(__file__).resolve().parents[1]
LEVELS = ("DEFAULT", "AVX2", "AVX512")
"""What ATen calls the instructions of x86-64 that it has kernels for, the oldest first."""
TARGETS = {"DEFAULT": "suite-SSE", "AVX2": "suite-AVX2"}
"""Targets of ``make`` that hold a newer processor down to these; ``test`` holds nothing down."""
HEADER = re.compile(r"^torch: (\w+), ")


@dataclass(frozen=True, slots=True)
class Run:
    """The suite, run once."""

    target: str
    """Of ``make``."""
    capability: str | None
    """As torch told it; None: the run ended before."""
    passed: bool
    wall_s: float = field(default=0.0, compare=False)
    user_cpu_s: float = field(default=0.0, compare=False)
    """Of all processes."""


def targets_up_to(best: str) -> tuple[str, ...]:
    """Targets of ``make`` that show all that a machine can, whose best is ``best`` of ``LEVELS``.

    Raises:
        ValueError: it is none of x86-64.
    """
    if best not in LEVELS:
        raise ValueError(f"torch runs on {best} here: use a machine with one of {LEVELS}")
    levels = LEVELS[: LEVELS.index(best) + 1]
    return (*(TARGETS[level] for level in levels[:-1]), "test")


def run(target: str, *variables: str) -> Run:
    """Make a target, with ``variables`` of make, and show what it says as it comes."""
    command = ["make", f"--directory={ROOT}", *variables, target]
    capability = None
    used, begun = getrusage(RUSAGE_CHILDREN).ru_utime, time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            print(line, end="", flush=True)
            if found := HEADER.match(line):
                capability = found[1]
    return Run(
        target,
        capability,
        process.returncode == 0,
        wall_s=time.perf_counter() - begun,
        user_cpu_s=getrusage(RUSAGE_CHILDREN).ru_utime - used,
    )


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
        cost = f"{each.wall_s:.0f} s, {each.user_cpu_s:.0f} s of user CPU"
        print(f"{each.target}: {each.capability or 'nothing ran'}, {outcome}, {cost}")
    shown = {each.capability for each in runs}
    print(f"not shown here: {', '.join(level for level in LEVELS if level not in shown) or 'none'}")
    values: dict[str, float] = {"capabilities_green": len(green(runs))}
    if runs[-1].passed:
        values["make_test_wall_s"] = round(runs[-1].wall_s, 1)
        values["make_test_user_cpu_s"] = round(runs[-1].user_cpu_s, 1)
    record(figures, values)
    if not all(each.passed for each in runs):
        raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(main)
