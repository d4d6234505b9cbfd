"""Runs veilcamd as a systemd unit in a virtual machine, and prints what held.

    sudo python tests/system/virtual_machine/run.py --figures benchmarks/results/daemon.json
    sudo python tests/system/virtual_machine/run.py --architecture arm64

Needs a Linux machine with x86-64 processor, root rights for building the image, and the programs
of ``TOOLS``; for arm64 those of ``FOREIGN_TOOLS`` besides, and binfmt_misc. No KVM is needed: the
processor is emulated.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

# A script that is run by its path finds no packages of the repository.
sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from benchmarks.figures import Origin, record_figures
from deploy.debian.build import Architecture
from tests.system.debian_package.emulation import EmulationError, register
from tests.system.obstacle import obstacle

ROOT = Path(__file__).resolve().parents[3]
IMAGE = Path(__file__).with_name("build-image.sh")
BUILD = ROOT / "build" / "virtual-machine"
TOOLS = {"mmdebstrap": "mmdebstrap", "mke2fs": "e2fsprogs", "cpio": "cpio", "xz": "xz-utils"}
FOREIGN_TOOLS = {"arch-test": "arch-test"}
EXPECTED = 14

console = Console(highlight=False)


@dataclass(frozen=True)
class Result:
    name: str
    passed: bool
    detail: str


@dataclass(frozen=True)
class Machine:
    emulator: str
    package: str
    kernel: str
    arguments: tuple[str, ...]
    """Of the emulator: processor and serial ports; what ttyS1 takes is the file ``{results}``."""
    figure: str


MACHINES: Mapping[Architecture, Machine] = {
    Architecture.AMD64: Machine(
        emulator="qemu-system-x86_64",
        package="qemu-system-x86",
        kernel="console=ttyS0",
        arguments=(
            *("-accel", "tcg,thread=multi,tb-size=256", "-cpu", "max", "-smp", "2"),
            *("-serial", "stdio", "-serial", "file:{results}", "-serial", "null"),
            *("-serial", "null"),
        ),
        figure="l2_passed",
    ),
    Architecture.ARM64: Machine(
        emulator="qemu-system-aarch64",
        package="qemu-system-arm",
        # Linux changes page tables at every entry where its own address is random; each change
        # empties what the emulator remembers of them.
        kernel="console=ttyAMA0 nokaslr mitigations=off",
        arguments=(
            # Of a Raspberry Pi 4. For that of a 5 Linux works around a fault of it by saying
            # twice what to forget, which takes an emulator long; and `max` signs pointers.
            *("-machine", "virt", "-cpu", "cortex-a72", "-smp", "1"),
            # An instruction takes 1 ns of the machine's time, and what it waits for comes at once:
            # no deadline depends on the machine below, or on what else that does.
            *("-icount", "shift=0,sleep=off", "-accel", "tcg,tb-size=512"),
            # Its own serial port is the console; four more are on a card.
            *("-serial", "stdio", "-chardev", "file,id=port1,path={results}"),
            *("-chardev", "null,id=port0", "-chardev", "null,id=port2"),
            *("-chardev", "null,id=port3", "-device"),
            "pci-serial-4x,chardev1=port0,chardev2=port1,chardev3=port2,chardev4=port3",
        ),
        figure="vm_arm64",
    ),
}


def boot(machine: Machine, build: Path) -> Iterator[str]:
    results = build / "results"
    results.unlink(missing_ok=True)
    command = [
        *(machine.emulator, "-m", "1536", "-display", "none", "-no-reboot", "-net", "none"),
        *("-kernel", str(build / "vmlinuz"), "-initrd", str(build / "initrd.gz")),
        *("-append", f"{machine.kernel} quiet systemd.show_status=false"),
        *("-drive", f"file={build / 'disk.img'},format=raw,if=virtio,snapshot=on"),
        *(argument.replace("{results}", str(results)) for argument in machine.arguments),
    ]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, errors="replace"
    ) as process:
        assert process.stdout is not None
        try:
            yield from process.stdout
        finally:
            process.kill()


def results(build: Path) -> list[Result]:
    file = build / "results"
    lines = file.read_text(errors="replace").splitlines() if file.exists() else []
    return [Result(**json.loads(line)) for line in lines if line.startswith("{")]


def table(architecture: Architecture, found: list[Result]) -> Table:
    title = f"veilcamd under systemd, in a virtual machine ({architecture.value})"
    made = Table("check", "", "what was seen", title=title, title_justify="left")
    for result in found:
        mark = "[green]passed[/]" if result.passed else "[red]FAILED[/]"
        made.add_row(result.name, mark, result.detail)
    return made


def main(
    *,
    architecture: Annotated[
        Architecture, typer.Option(help="Of the machine.")
    ] = Architecture.AMD64,
    build: Annotated[
        Path | None, typer.Option(help=f"Folder for the image, 5 GB; {BUILD.name}/ARCHITECTURE.")
    ] = None,
    again: Annotated[bool, typer.Option(help="Boot the image that is there already.")] = False,
    figures: Annotated[Path | None, typer.Option(help="Record to write the figure into.")] = None,
) -> None:
    """Build the image, boot it, and make the checks in it."""
    machine = MACHINES[architecture]
    build = build or BUILD / architecture.value
    emulated = architecture is not Architecture.AMD64
    tools = {machine.emulator: machine.package, **TOOLS, **(FOREIGN_TOOLS if emulated else {})}
    if reason := obstacle(tools):
        console.print(f"NOT RUN: {reason}")
        return
    if not again:
        try:
            if emulated:
                register(architecture.value)
        except EmulationError as error:
            console.print(f"NOT RUN: {error}")
            return
        subprocess.run(
            [str(IMAGE), architecture.value, str(build)],
            check=True,
            env={**os.environ, "BUILDER": sys.executable},
        )
    console.print("machine: booting")
    for line in boot(machine, build):
        console.print(line.rstrip(), markup=False, soft_wrap=True)
    found = results(build)
    console.print(table(architecture, found))
    passed = len(found) == EXPECTED and all(result.passed for result in found)
    console.print(f"{sum(result.passed for result in found)} of {EXPECTED} checks passed")
    if figures is not None:
        # The source in the image, which may be older than what lies around it.
        origin = replace(Origin.here(), commit=(build / "commit").read_text().strip())
        record_figures(figures, {machine.figure: int(passed)}, origin=origin)
    raise SystemExit(0 if passed else 1)


if __name__ == "__main__":
    typer.run(main)
