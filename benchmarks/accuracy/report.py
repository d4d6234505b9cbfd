"""Measured points as a table and as JSON."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import torch
from rich.table import Column, Table

from benchmarks.accuracy.measure import Point, pareto_front
from benchmarks.figures import machine


@dataclass(frozen=True, slots=True)
class Result:
    """One job, measured."""

    name: str
    title: str
    points: Sequence[Point]
    skipped: Mapping[str, str]


def duration(seconds: float) -> str:
    """A time in the unit that suits it, with three digits."""
    for factor, unit in ((1.0, "s"), (1e3, "ms")):
        if seconds * factor >= 1:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e6:.3g} us"


def table(result: Result) -> Table:
    """Fastest first; a dot marks what no other setting beats in both time and error."""
    front = {id(point) for point in pareto_front(result.points)}
    shown = Table(
        "",
        "method",
        "dials",
        Column("dtype", no_wrap=True),
        Column("error", justify="right", no_wrap=True),
        Column("time", justify="right", no_wrap=True),
        Column("set-up", justify="right", no_wrap=True),
        title=result.title,
        title_justify="left",
        pad_edge=False,
    )
    for point in sorted(result.points, key=lambda p: p.seconds):
        shown.add_row(
            "●" if id(point) in front else "",
            point.method + ("" if point.supported else " (outside its range)"),
            ", ".join(f"{name} {value}" for name, value in point.dials.items() if name != "dtype"),
            str(point.dials.get("dtype", "")),
            f"{point.error:.1e}",
            duration(point.seconds),
            duration(point.prepare_seconds),
            style="bold" if id(point) in front else None,
        )
    return shown


def write_json(path: Path, results: Sequence[Result], *, quick: bool) -> None:
    """Write every point with the machine, date, and versions that it was measured with."""
    record = {
        "date": datetime.now(UTC).date().isoformat(),
        "machine": machine(),
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
        "quick": quick,
        "jobs": {
            result.name: {
                "title": result.title,
                "points": [dataclasses.asdict(point) for point in result.points],
                "front": [point.label for point in pareto_front(result.points)],
                "skipped": dict(result.skipped),
            }
            for result in results
        },
    }
    path.write_text(json.dumps(record, indent=1) + "\n")
