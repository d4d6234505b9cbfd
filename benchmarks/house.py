"""What the checks cost: wall time, and user time of all processes, of ``make``'s targets.

    python -m benchmarks.house --figures benchmarks/results/house.json

Run it on two quiet cores, and once before, so that mypy's cache is warm.
"""

from __future__ import annotations

import os
import resource
import subprocess
import time
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.figures import FiguresOption, record

ROOT = Path(__file__).resolve().parents[1]
TARGETS = ("lint", "types", "layers", "check", "test")


def cost(command: list[str]) -> tuple[float, float]:
    """Wall time, and user time of the command and all that it starts [s]; it has to succeed."""
    used, begun = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime, time.perf_counter()
    subprocess.run(command, check=True)
    took = time.perf_counter() - begun
    return took, resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - used


def main(
    targets: Annotated[list[str] | None, typer.Argument(help="Of make; those that check.")] = None,
    figures: FiguresOption = None,
) -> None:
    """Make one target after the other, and say what each took."""
    values: dict[str, float] = {}
    for target in targets or TARGETS:
        wall, used = cost(["make", f"--directory={ROOT}", target])
        values[f"make_{target}_wall_s"] = round(wall, 1)
        values[f"make_{target}_user_cpu_s"] = round(used, 1)
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    for name, value in values.items():
        print(f"{name}: {value:.1f}")
    print(f"load {load}")
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
