"""Records of what was measured, and the provenance of what was made.

A record of figures is one JSON file, filled by the commands that measured:

``{"NAME": {"value": ..., "command": ..., "commit": ..., "date": ..., "machine": ...}}``
"""

import fcntl
import json
import math
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Self

import torch
from pydantic import JsonValue
from torch import distributed

from veilcam_optics.accuracy.report import machine
from veilcam_optics.files import write_whole
from veilcam_training.errors import TrainingError, require
from veilcam_training.files import check_folder


@dataclass(frozen=True)
class Origin:
    """What measured a figure, from which source, when and where."""

    command: str
    commit: str
    date: str
    """Of the day, as 2026-01-31 (UTC)."""
    machine: str

    @classmethod
    def here(cls, command: Sequence[str] | None = None) -> Self:
        """Now, on this machine, by ``command``: this process's own by default."""
        return cls(
            command=shlex.join(command if command is not None else own_command()),
            commit=commit(),
            date=datetime.now(UTC).date().isoformat(),
            machine=machine(),
        )


def record_figures(
    path: Path,
    values: Mapping[str, float],
    command: Sequence[str] | None = None,
    *,
    origin: Origin | None = None,
) -> None:
    """Write figures into the record at ``path``; other figures in it stay as they are.

    Args:
        path: JSON file, made if it is not there.
        values: by name.
        command: that measured them; this process's own by default.
        origin: of figures that were measured before, in the place of a command.

    Raises:
        TrainingError: a figure that is no finite number, or a place as :func:`check_record` says.
    """
    check_record(path)
    for name, value in values.items():
        require(math.isfinite(value), f"figure {name} = {value} is not valid: use a finite number")
    entry = asdict(Origin.here(command) if origin is None else origin)
    path.parent.mkdir(parents=True, exist_ok=True)
    # Two benchmarks may end at the same time: one at a time reads, changes and writes.
    with _locked(path.parent):
        record = _read(path)
        for name, value in values.items():
            record[name] = {"value": value, **entry}
        write_whole(path, f"{json.dumps(record, indent=1, sort_keys=True)}\n".encode())


def check_record(path: Path) -> None:
    """Refuse, also before the work that measures, a place that can hold no record.

    Raises:
        TrainingError: a place that cannot be written to, or a file that is no such record.
    """
    check_folder("--figures", path.parent)
    _read(path)


def provenance(settings: JsonValue, digests: Mapping[str, str]) -> dict[str, JsonValue]:
    """Settings, data, versions, date and command, as JSON: enough to make an artefact again."""
    return {
        "settings": settings,
        "data_sha256": dict(digests),
        "versions": {
            "veilcam": version("veilcam"),
            "torch": torch.__version__,
            "python": platform.python_version(),
        },
        "processes": distributed.get_world_size() if distributed.is_initialized() else 1,
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


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def own_command() -> list[str]:
    """This process's command line as one types it: programs by name, modules by ``python -m``."""
    program, arguments = Path(sys.argv[0]), sys.argv[1:]
    spec = sys.modules["__main__"].__spec__
    if spec is not None:
        return ["python", "-m", spec.name.removesuffix(".__main__"), *arguments]
    if program.suffix == ".py":
        script = program.resolve()
        inside = script.is_relative_to(Path.cwd())
        return ["python", str(script.relative_to(Path.cwd()) if inside else program), *arguments]
    return [program.name, *arguments]


def _read(path: Path) -> dict[str, object]:
    try:
        record = json.loads(path.read_text())
    except FileNotFoundError:
        return {}
    except (OSError, ValueError):
        record = None
    if not isinstance(record, dict):
        raise TrainingError(f"{path} is not a record of figures: move it away or mend it")
    return record


def _git(folder: Path, *arguments: str) -> str:
    result = subprocess.run(  # noqa: S603 - fixed arguments
        ["git", "-C", str(folder), *arguments],  # noqa: S607
        check=True,
        capture_output=True,
        text=True,
    )
    return result.stdout.strip()
