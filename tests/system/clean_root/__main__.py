"""Runs a command of the README in a root of Debian 13 with Python, venv, git and make alone.

    sudo python -m tests.system.clean_root demo --figures benchmarks/results/deploy.json
    sudo python -m tests.system.clean_root test --figures benchmarks/results/deploy.json

Needs root, and mmdebstrap. The root has this checkout as it was committed, a user without rights,
and the network. It is kept in ``build/clean-root``.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer
from benchmarks.figures import FiguresOption, record
from rich.console import Console
from tests.system.debian_package.root import Root, archive
from tests.system.obstacle import obstacle

ROOT = Path(__file__).resolve().parents[3]
BUILD = ROOT / "build" / "clean-root"
TOOLS = {"mmdebstrap": "mmdebstrap"}
SUITE = "trixie"
PACKAGES = ("ca-certificates", "git", "make", "python3", "python3-venv")
HOME, USER = "/home/newcomer", "1000:1000"
ENVIRONMENT = {
    "HOME": HOME,
    "LANG": "C.UTF-8",
    "PATH": "/usr/local/bin:/usr/bin:/bin",
    # Of a container with slow networks.
    "PIP_DEFAULT_TIMEOUT": "180",
}

console = Console(highlight=False)


def clean(folder: Path) -> Path:
    architecture = subprocess.check_output(["dpkg", "--print-architecture"], text=True).strip()
    root = Root.unpack(archive(folder, SUITE, architecture, PACKAGES), folder / "root").path
    home = root / HOME.lstrip("/")
    with (root / "etc/passwd").open("a") as users:
        users.write(f"newcomer:x:{USER}::{HOME}:/bin/bash\n")
    shutil.copyfile("/etc/resolv.conf", root / "etc/resolv.conf")
    clone = ["git", "clone", "--quiet", "--no-local", str(ROOT), str(home / "veilcam")]
    subprocess.run(clone, check=True)
    subprocess.run(["chown", "--recursive", USER, str(home)], check=True)
    return root


def make(root: Path, target: str) -> int:
    inside = (
        'mount -t proc proc "$0/proc" && mount --rbind /dev "$0/dev" && '
        f'exec {shutil.which("chroot")} --userspec={USER} "$0" '
        f'sh -c "cd {HOME}/veilcam && exec make $1"'
    )
    command = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-c", inside]
    return subprocess.call([*command, str(root), target], env=ENVIRONMENT)


def main(
    target: Annotated[Literal["demo", "test"], typer.Argument(help="As in 'make demo'.")],
    *,
    folder: Annotated[Path, typer.Option("--build", help="For the root.")] = BUILD,
    figures: FiguresOption = None,
) -> None:
    """Make the root, and run the command in it."""
    if reason := obstacle(TOOLS):
        console.print(f"NOT RUN: {reason}")
        return
    folder.mkdir(parents=True, exist_ok=True)
    root = clean(folder)
    passed = make(root, target) == 0
    console.print(f"make {target}: {'passed' if passed else 'FAILED'}")
    record(figures, {f"clean_root_{target}": int(passed)})
    shutil.rmtree(root)
    sys.exit(0 if passed else 1)


if __name__ == "__main__":
    typer.run(main)
