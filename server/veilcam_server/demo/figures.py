"""Figures as JSON: one entry a name, with what made it, merged into the file that is there."""

from __future__ import annotations

import json
import os
import platform
import subprocess
from datetime import UTC, datetime
from pathlib import Path

from veilcam_client import __version__
from veilcam_server.errors import StartError


def record(path: Path, name: str, value: float, command: str) -> None:
    """Set ``name`` in the JSON file ``path`` and leave its other figures as they are.

    Raises:
        StartError: the file cannot be read or written.
    """
    try:
        figures = json.loads(path.read_text()) if path.exists() else {}
        figures[name] = {
            "value": value,
            "command": command,
            "commit": _commit(),
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "machine": _machine(),
        }
        neighbour = path.with_name(f".{path.name}.new")
        path.parent.mkdir(parents=True, exist_ok=True)
        neighbour.write_text(json.dumps(figures, indent=2, sort_keys=True) + "\n")
        neighbour.replace(path)
    except (OSError, ValueError, TypeError) as error:
        raise StartError(f"figures cannot be written to {path} ({error}): check it") from None


def _commit() -> str:
    """The commit of the source tree, or the version when installed without one."""
    try:
        answer = subprocess.run(
            ["git", "rev-parse", "HEAD"],  # noqa: S607 - whichever git the user has
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return f"veilcam {__version__}"
    return answer.stdout.strip()


def _machine() -> str:
    return f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, {_processor()}"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or "unknown processor")
