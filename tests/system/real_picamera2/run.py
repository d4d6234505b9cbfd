"""Builds libcamera's virtual pipeline, and runs the camera's driver on the real picamera2 on it.

    python tests/system/real_picamera2/run.py --figures benchmarks/results/daemon.json

``make test-libcamera`` is this without the record. Where libcamera or picamera2 cannot be had it
says so and ends with 77: what did not run is not recorded.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

# A script that is run by its path finds no packages of the repository.
sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from benchmarks.figures import record_figures

ROOT = Path(__file__).resolve().parents[3]
TESTS, PYTHON = "tests/system/real_picamera2", "build/libcamera/venv/bin/python"


def main(
    *, figures: Annotated[Path | None, typer.Option(help="Record to write figures into.")] = None
) -> None:
    """Build what the tests need, if it is not there, and run them."""
    built = subprocess.run([f"{TESTS}/build.sh", sys.executable], cwd=ROOT, check=False)
    if built.returncode != 0:
        raise SystemExit(built.returncode)
    tests = subprocess.run([PYTHON, "-m", "pytest", TESTS], cwd=ROOT, check=False)
    if figures is not None:
        record_figures(figures, {"l1_passed": int(tests.returncode == 0)})
    raise SystemExit(tests.returncode)


if __name__ == "__main__":
    typer.run(main)
