"""Installs the Debian package in a root of Debian, and prints what held.

    sudo python -m tests.system.debian_package --figures benchmarks/results/deploy.json
    sudo python -m tests.system.debian_package --architecture arm64 --suite bookworm

Needs root, and the programs of ``TOOLS``. Roots and packages are kept in ``build/debian``.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer
from benchmarks.figures import FiguresOption, record
from deploy.debian.build import Architecture, BuildError, build
from rich.console import Console
from tests.system.obstacle import obstacle
from tests.unit.client.recordings import Daemon

from veilcam_client.recording import record as record_captures

from .checks import Checks, Result
from .emulation import EmulationError, register
from .reading import measured
from .root import Root, archive

ROOT = Path(__file__).resolve().parents[3]
BUILD = ROOT / "build" / "debian"
TOOLS = {"dpkg-deb": "dpkg", "mmdebstrap": "mmdebstrap", "unshare": "util-linux"}
FOREIGN_TOOLS = {"arch-test": "arch-test"}
EMULATED = 20.0
CAPTURES = 40
SUITE = "bookworm"
"""Of the figures of room and time; the older of the two."""

console = Console(highlight=False)


def native() -> str | None:
    """Return Debian's name of this machine's architecture; None where there is no Debian."""
    if shutil.which("dpkg") is None:
        return None
    command = ["dpkg", "--print-architecture"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def recording(build: Path) -> Path:
    """Return what a camera that is made up answered; made if it is not there."""
    file = build / "recording.jsonl"
    if not file.exists():
        record_captures(Daemon().camera(), file, count=CAPTURES, labels=True)
    return file


def main(
    *,
    architecture: Annotated[Architecture, typer.Option(help="Of the root.")] = Architecture.AMD64,
    suite: Annotated[str, typer.Option(help="Of Debian.")] = SUITE,
    package: Annotated[
        Path | None, typer.Option(help="That was built before; otherwise it is built.")
    ] = None,
    folder: Annotated[Path, typer.Option("--build", help="For roots and packages.")] = BUILD,
    figures: FiguresOption = None,
) -> None:
    """Make the root, install the package in it, and make the checks."""
    emulated = architecture.value != native()
    if reason := obstacle({**TOOLS, **(FOREIGN_TOOLS if emulated else {})}):
        console.print(f"NOT RUN: {reason}")
        return
    folder.mkdir(parents=True, exist_ok=True)
    try:
        if emulated:
            register(architecture.value)
        package = package or build(architecture, folder)
    except (BuildError, EmulationError) as error:
        console.print(f"NOT RUN: {error}")
        return
    root = Root.unpack(archive(folder, suite, architecture.value), folder / "root")
    digits = folder / "measured.npz"
    measured(digits)
    patience = EMULATED if emulated else 1.0
    checks = Checks(root, package, recording(folder), digits, folder, patience)

    def report(result: Result) -> None:
        mark = "[green]passed[/]" if result.passed else "[red]FAILED[/]"
        console.print(f"{mark} {result.name}: ", end="")
        console.print(result.detail, markup=False, soft_wrap=True)

    passed = checks.run(report)
    name = f"{architecture.value}_{suite}"
    values: dict[str, float] = {name: int(passed)}
    values |= {f"{name}_accuracy_{mode}": value for mode, value in checks.accuracies.items()}
    if passed and not emulated and suite == SUITE:
        values |= checks.figures
    record(figures, values)
    shutil.rmtree(root.path)
    sys.exit(0 if passed else 1)


if __name__ == "__main__":
    typer.run(main)
