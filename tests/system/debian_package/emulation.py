"""Programs of another processor: Linux hands them to QEMU, once an entry in binfmt_misc says so."""

from __future__ import annotations

import subprocess
from pathlib import Path

BINFMT = Path("/proc/sys/fs/binfmt_misc")
RULES = Path("/usr/lib/binfmt.d")
PROCESSORS = {"arm64": "qemu-aarch64", "amd64": "qemu-x86_64"}
"""Debian's name of an architecture, and the entry of ``qemu-user-static`` for it."""


class EmulationError(Exception):
    """Programs of the architecture cannot be run here; the message ends with what to do."""


def register(architecture: str, binfmt: Path = BINFMT, rules: Path = RULES) -> None:
    """Let this machine run an architecture's programs, also within a root of its own."""
    name = PROCESSORS[architecture]
    rule = rules / f"{name}.conf"
    if not rule.exists():
        raise EmulationError(f"there is no {rule}: apt install qemu-user-static")
    if not (binfmt / "register").exists():
        mount = ["mount", "-t", "binfmt_misc", "binfmt_misc", str(binfmt)]
        if subprocess.run(mount, check=False, capture_output=True).returncode != 0:
            raise EmulationError(
                f"{binfmt} cannot be mounted: use a kernel with binfmt_misc, outside of a container"
            )
    if (binfmt / name).exists():
        return
    try:
        (binfmt / "register").write_text(rule.read_text().strip())
    except OSError as error:
        raise EmulationError(
            f"Linux refuses the entry of {rule} ({error.strerror}): run it as root of the machine"
        ) from None
