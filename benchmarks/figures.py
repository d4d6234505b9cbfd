"""Figures of a measurement: the option that asks for them, and the record that they go to."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from veilcam_training.experiments.records import record_figures

FiguresOption: TypeAlias = Annotated[
    Path | None, typer.Option("--figures", help="Record to write figures into.")
]


def record(figures: Path | None, values: Mapping[str, float]) -> None:
    """Write ``values`` into the record of figures, where one was asked for."""
    if figures is not None:
        record_figures(figures, values)
