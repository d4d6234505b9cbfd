"""Packages made from one that was built: the same of a later version, whole or broken."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

BROKEN = 'raise RuntimeError("this release is broken")\n'
"""At the top of the daemon: imports end with it, as they do where a wheel does not fit."""
DAEMON = "usr/lib/veilcam/unpacked/lib/veilcam_server/daemon.py"


def variant(package: Path, version: str, folder: Path, *, broken: bool = False) -> Path:
    stage = folder / f"stage-{version}"
    if stage.exists():
        shutil.rmtree(stage)
    subprocess.run(["dpkg-deb", "--raw-extract", str(package), str(stage)], check=True)
    control = stage / "DEBIAN/control"
    text = control.read_text()
    control.write_text(re.sub(r"(?m)^Version: .*$", f"Version: {version}", text))
    (stage / "usr/lib/veilcam/unpacked/RELEASE").write_text(f"{version}-variant\n")
    if broken:
        daemon = stage / DAEMON
        daemon.write_text(BROKEN + daemon.read_text())
        # Byte code says of no source when it was written.
        for compiled in (daemon.parent / "__pycache__").glob("daemon.*.pyc"):
            compiled.unlink()
    made = folder / f"veilcam_{version}_{architecture_of(package)}.deb"
    subprocess.run(
        ["dpkg-deb", "--root-owner-group", "-Znone", "--build", str(stage), str(made)],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    shutil.rmtree(stage)
    return made


def architecture_of(package: Path) -> str:
    command = ["dpkg-deb", "--field", str(package), "Architecture"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
