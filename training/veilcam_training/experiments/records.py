"""Provenance of what was made: settings, data, versions, commit, date and command."""

import platform
import shlex
import subprocess
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import torch
from pydantic import JsonValue


def provenance(settings: JsonValue, digests: Mapping[str, str]) -> dict[str, JsonValue]:
    """Return settings, data, versions, date and command as JSON, to make an artefact again."""
    return {
        "settings": settings,
        "data_sha256": dict(digests),
        "versions": {
            "veilcam": version("veilcam"),
            "torch": torch.__version__,
            "python": platform.python_version(),
        },
        "commit": commit(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        # A path may be of bytes that JSON cannot hold.
        "command": shlex.join(own_command()).encode(errors="backslashreplace").decode(),
    }


def commit() -> str:
    """Git commit of this source tree, ``-dirty`` if its packages were changed; or ``unknown``."""
    here = Path(__file__).parent
    try:
        head = _git(here, "rev-parse", "--short=12", "HEAD")
        top = Path(_git(here, "rev-parse", "--show-toplevel"))
        names = ("client", "optics", "server", "training")
        packages = [name for name in names if (top / name).is_dir()]
        changed = _git(top, "status", "--porcelain", "--untracked-files=no", "--", *packages)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{head}-dirty" if changed else head


def own_command() -> list[str]:
    """Return this process's command line as one types it: programs by name, modules by ``-m``."""
    program, arguments = Path(sys.argv[0]), sys.argv[1:]
    spec = sys.modules["__main__"].__spec__
    if spec is not None:
        return ["python", "-m", spec.name.removesuffix(".__main__"), *arguments]
    if program.suffix == ".py":
        script = program.resolve()
        inside = script.is_relative_to(Path.cwd())
        if inside and script.name == "__main__.py":  # a worker of a module's command has no spec
            module = ".".join(script.parent.relative_to(Path.cwd()).parts)
            return ["python", "-m", module, *arguments]
        return ["python", str(script.relative_to(Path.cwd()) if inside else program), *arguments]
    return [program.name, *arguments]


def _git(folder: Path, *arguments: str) -> str:
    result = subprocess.run(  # noqa: S603 - fixed arguments
        ["git", "-C", str(folder), *arguments],  # noqa: S607
        check=True,
        capture_output=True,
        text=True,
    )
    return result.stdout.strip()
