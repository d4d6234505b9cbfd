"""Runs README's two commands with each Python that the package is for, and prints which passed.

    python -m tests.system.pythons 3.12=/usr/bin/python3.12 --figures benchmarks/results/deploy.json

Each gets a fresh clone of what is committed, and an environment of its own in it. A machine that
has no other Python is what ``tests.system.clean_root`` is for.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer
from benchmarks.figures import FiguresOption, record
from rich.console import Console

ROOT = Path(__file__).resolve().parents[3]
BUILD = ROOT / "build" / "pythons"
TARGETS = ("demo", "test")

console = Console(highlight=False)


class VersionError(Exception):
    """A Python is not what it was said to be; the message ends with what to do."""


def parse(asked: str) -> tuple[str, Path]:
    version, _, program = asked.partition("=")
    if not program:
        raise VersionError(f"{asked!r} names no program: write it as 3.12=/usr/bin/python3.12")
    shown = "import sys; print('{}.{}'.format(*sys.version_info))"
    try:
        done = subprocess.run([program, "-c", shown], check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise VersionError(f"{program} cannot be run ({error}): name another one") from None
    if done.stdout.strip() != version:
        raise VersionError(f"{program} is Python {done.stdout.strip()}: write that before the '='")
    return version, Path(program)


def passes(version: str, program: Path, folder: Path) -> bool:
    clone = folder / version
    shutil.rmtree(clone, ignore_errors=True)
    subprocess.run(["git", "clone", "--quiet", "--no-local", str(ROOT), str(clone)], check=True)
    for target in TARGETS:
        log = folder / f"{version}-{target}.log"
        console.print(f"Python {version}: make {target}; its output goes to {log}")
        with log.open("w") as output:
            command = ["make", target, f"PYTHON={program}"]
            # What leads Python to packages would lead it past the environment of the clone.
            own = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
            if subprocess.call(command, cwd=clone, env=own, stdout=output, stderr=output) != 0:
                console.print(f"Python {version}: make {target} FAILED; {clone} is kept")
                return False
    shutil.rmtree(clone)
    console.print(f"Python {version}: passed")
    return True


def main(
    pythons: Annotated[list[str], typer.Argument(help="Of each, VERSION=PROGRAM.")],
    *,
    folder: Annotated[Path, typer.Option("--build", help="For the clones.")] = BUILD,
    figures: FiguresOption = None,
) -> None:
    """Run both commands with each Python."""
    try:
        asked = dict(parse(each) for each in pythons)
    except VersionError as error:
        raise typer.BadParameter(str(error)) from None
    folder.mkdir(parents=True, exist_ok=True)
    found = {version: passes(version, program, folder) for version, program in asked.items()}
    named = {f"python_{version.replace('.', '_')}": int(green) for version, green in found.items()}
    record(figures, named)
    sys.exit(0 if all(found.values()) else 1)


if __name__ == "__main__":
    typer.run(main)
