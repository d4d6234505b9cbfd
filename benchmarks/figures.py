"""Figures of measurements: the option that asks for them, and the record that they go to.

A record is one JSON file, filled by the commands that measured:

``{"NAME": {"value": ..., "command": ..., "commit": ..., "date": ..., "machine": ...}}``
"""

from __future__ import annotations

import fcntl
import json
import math
import os
import platform
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Self, TypeAlias

import typer

from veilcam_optics.files import write_whole
from veilcam_training.errors import TrainingError, require
from veilcam_training.experiments.records import commit, own_command
from veilcam_training.files import check_folder

FiguresOption: TypeAlias = Annotated[
    Path | None, typer.Option("--figures", help="Record to write figures into.")
]


def record(figures: Path | None, values: Mapping[str, float]) -> None:
    """Write ``values`` into the record of figures, where one was asked for."""
    if figures is not None:
        record_figures(figures, values)


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


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


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


def machine() -> str:
    """Return the processor and the number of its cores, e.g. ``AMD EPYC 7B13, 2 cores``."""
    return f"{_processor()}, {os.cpu_count()} cores"


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
