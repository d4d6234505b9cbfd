"""Builds ``deploy/Containerfile`` with buildah, starts its daemon, and asks it for labels.

    sudo python -m tests.system.container --figures benchmarks/results/deploy.json

Needs root, and the programs of ``TOOLS``. No registry is asked: in the place of the image
that the file begins with stands a root of Debian 12 with its Python. What pip is told by
``PIP_CERT`` and ``PIP_FIND_LINKS`` here, it is told there too. All is kept in ``build/container``.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from benchmarks.figures import FiguresOption, record
from rich.console import Console
from tests.system.debian_package.root import archive
from tests.system.obstacle import obstacle

from veilcam_client import Camera
from veilcam_server.demo_data import load_digits

ROOT = Path(__file__).resolve().parents[3]
BUILD = ROOT / "build" / "container"
TOOLS = {"buildah": "buildah", "mmdebstrap": "mmdebstrap"}
BASE, IMAGE = "localhost/veilcam-base", "localhost/veilcam-simulated"
GREETING = "veilcamd listening on "
DIGITS = 20
"""That are held up; the bundle of the demonstration reads 19 of 20 and more."""
LEAST = 0.8
SUITE, PACKAGES = "bookworm", ("ca-certificates", "python3", "python3-venv")
"""Of what stands for the image that the file begins with."""

console = Console(highlight=False)


class Buildah:
    def __init__(self, folder: Path) -> None:
        self._store = ("--root", str(folder / "images"), "--runroot", str(folder / "run"))

    def command(self, name: str, *arguments: str) -> list[str]:
        return ["buildah", "--storage-driver", "vfs", *self._store, name, *arguments]

    def __call__(self, name: str, *arguments: str) -> str:
        command = self.command(name, *arguments)
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        return (done.stdout.strip().splitlines() or [""])[-1]


def base(buildah: Buildah, folder: Path) -> None:
    [architecture] = subprocess.check_output(
        ["dpkg", "--print-architecture"], text=True
    ).splitlines()
    container = buildah("from", "scratch")
    buildah("add", "--quiet", container, str(archive(folder, SUITE, architecture, PACKAGES)), "/")
    buildah("commit", "--quiet", "--rm", container, BASE)


def pip_settings(folder: Path) -> list[str]:
    """Return mounts that tell pip in the image what it is told here, by its environment."""
    mounts, lines = [], ["[global]"]
    for name, setting in (("PIP_CERT", "cert"), ("PIP_FIND_LINKS", "find-links")):
        place = os.environ.get(name)
        if place and Path(place).exists():
            mounts.append(f"--volume={place}:{place}:ro")
            lines.append(f"{setting} = {place}")
    settings = folder / "pip.conf"
    settings.write_text("\n".join(lines) + "\n")
    return [*mounts, f"--volume={settings}:/etc/pip.conf:ro"]


@contextmanager
def running(buildah: Buildah, container: str) -> Iterator[str]:
    config = json.loads(
        subprocess.check_output(buildah.command("inspect", "--type", "image", IMAGE))
    )["OCIv1"]["config"]
    command = [*config["Entrypoint"], *config["Cmd"], "--port", "0"]
    # `run` keeps to USER and ENV of the image; the network is the host's.
    with subprocess.Popen(
        buildah.command("run", "--isolation", "chroot", container, "--", *command),
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        try:
            line = process.stdout.readline()
            assert line.startswith(GREETING), f"it did not start: {line!r}"
            yield line.removeprefix(GREETING).strip()
        finally:
            process.terminate()


def accuracy(url: str) -> float:
    digits = load_digits()
    right = 0
    with Camera(url) as camera:
        for image, label in zip(digits.images[:DIGITS], digits.labels, strict=False):
            camera.simulation.hold_scene(image)
            right += camera.classify().label == str(label)
    return right / DIGITS


def main(
    *,
    folder: Annotated[Path, typer.Option("--build", help="For images.")] = BUILD,
    torch_index: Annotated[
        str | None, typer.Option(help="In the place of the file's; '' for where pip looks anyway.")
    ] = None,
    figures: FiguresOption = None,
) -> None:
    """Build, start and ask."""
    if reason := obstacle(TOOLS):
        console.print(f"NOT RUN: {reason}")
        return
    folder.mkdir(parents=True, exist_ok=True)
    buildah = Buildah(folder)
    base(buildah, folder)
    index = [] if torch_index is None else ["--build-arg", f"TORCH_INDEX={torch_index}"]
    buildah(
        *("bud", "--isolation", "chroot", "--build-arg", f"BASE={BASE}", *index),
        *pip_settings(folder),
        *("--file", str(ROOT / "deploy" / "Containerfile"), "--tag", IMAGE, str(ROOT)),
    )
    container = buildah("from", "--pull-never", IMAGE)
    try:
        with running(buildah, container) as url:
            found = accuracy(url)
    finally:
        buildah("rm", container)
    passed = found >= LEAST
    console.print(f"{url} read {found:.0%} of {DIGITS} digits: {'passed' if passed else 'FAILED'}")
    record(figures, {"container_accuracy": found})
    sys.exit(0 if passed else 1)


if __name__ == "__main__":
    typer.run(main)
