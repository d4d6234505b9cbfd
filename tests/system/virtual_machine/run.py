"""Runs veilcamd as a systemd unit in a virtual machine, and prints what held.

    sudo python tests/system/virtual_machine/run.py --figures benchmarks/results/daemon.json

Needs a Linux machine with x86-64 processor, root rights for building the image, and the programs
of ``TOOLS``. No KVM is needed: the processor is emulated, and two cores take a quarter of an hour.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from tests.system.obstacle import obstacle

from veilcam_training.experiments.records import Origin, record_figures

ROOT = Path(__file__).resolve().parents[3]
IMAGE = Path(__file__).with_name("build-image.sh")
BUILD = ROOT / "build" / "virtual-machine"
TOOLS = {
    "qemu-system-x86_64": "qemu-system-x86",
    "mmdebstrap": "mmdebstrap",
    "mke2fs": "e2fsprogs",
    "cpio": "cpio",
    "xz": "xz-utils",
}
"""Programs, and the Debian packages that have them."""
EXPECTED = 14
"""Checks; a machine that makes fewer has died on the way."""

console = Console(highlight=False)


@dataclass(frozen=True)
class Result:
    """Of one check."""

    name: str
    passed: bool
    detail: str


def boot(build: Path) -> Iterator[str]:
    """Boot the image, which stays as it is; return the lines of the console."""
    results = build / "results"
    results.unlink(missing_ok=True)
    machine = [
        *("qemu-system-x86_64", "-accel", "tcg,thread=multi,tb-size=256", "-cpu", "max"),
        *("-smp", "2", "-m", "1536", "-display", "none", "-no-reboot", "-net", "none"),
        *("-kernel", str(build / "vmlinuz"), "-initrd", str(build / "initrd.gz")),
        *("-append", "console=ttyS0 quiet systemd.show_status=false"),
        *("-drive", f"file={build / 'disk.img'},format=raw,if=virtio,snapshot=on"),
        *("-serial", "stdio", "-serial", f"file:{results}"),
        *("-serial", "null", "-serial", "null"),
    ]
    with subprocess.Popen(
        machine, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, errors="replace"
    ) as process:
        assert process.stdout is not None
        try:
            yield from process.stdout
        finally:
            process.kill()


def results(build: Path) -> list[Result]:
    """Return what the checks of the last boot found."""
    file = build / "results"
    lines = file.read_text(errors="replace").splitlines() if file.exists() else []
    return [Result(**json.loads(line)) for line in lines if line.startswith("{")]


def table(found: list[Result]) -> Table:
    """Return the results for a terminal."""
    made = Table(title="veilcamd under systemd, in a virtual machine", title_justify="left")
    for heading in ("check", "", "what was seen"):
        made.add_column(heading)
    for result in found:
        mark = "[green]passed[/]" if result.passed else "[red]FAILED[/]"
        made.add_row(result.name, mark, result.detail)
    return made


def main(
    *,
    build: Annotated[Path, typer.Option(help="Folder for the image, 5 GB.")] = BUILD,
    again: Annotated[bool, typer.Option(help="Boot the image that is there already.")] = False,
    figures: Annotated[Path | None, typer.Option(help="Record to write the figure into.")] = None,
) -> None:
    """Build the image, boot it, and make the checks in it."""
    reason = obstacle(TOOLS)
    if reason is not None:
        console.print(f"NOT RUN: {reason}")
        return
    if not again:
        subprocess.run(
            [str(IMAGE), str(build)], check=True, env={**os.environ, "BUILDER": sys.executable}
        )
    console.print("machine: booting")
    for line in boot(build):
        console.print(line.rstrip(), markup=False, soft_wrap=True)
    found = results(build)
    console.print(table(found))
    passed = len(found) == EXPECTED and all(result.passed for result in found)
    console.print(f"{sum(result.passed for result in found)} of {EXPECTED} checks passed")
    if figures is not None:
        # The source in the image, which may be older than what lies around it.
        origin = replace(Origin.here(), commit=(build / "commit").read_text().strip())
        record_figures(figures, {"l2_passed": int(passed)}, origin=origin)
    raise SystemExit(0 if passed else 1)


if __name__ == "__main__":
    typer.run(main)
