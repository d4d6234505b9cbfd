"""Options and means that the commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer
from rich.console import Console
from rich.progress import Progress

from veilcam_training.bundle import Bundle, read_bundle

WorkArgument: TypeAlias = Annotated[
    Path, typer.Argument(help="Folder for what was measured: resumes what is in it.")
]
BundleOption: TypeAlias = Annotated[Path, typer.Option(help="Bundle of mode fresh.")]
SeedOption: TypeAlias = Annotated[
    int, typer.Option(help="Of scenes, noise and folds; keys are the kernel's.")
]
EpochsOption: TypeAlias = Annotated[int, typer.Option(min=1, help="Most that a network is fitted.")]


def shown_progress() -> Progress:
    """Progress on standard error."""
    return Progress(console=Console(stderr=True))


def fresh_bundle(path: Path) -> Bundle:
    """Read a bundle of mode fresh."""
    contents = read_bundle(path)
    if contents.fresh is None:
        raise typer.BadParameter(f"{path} is of mode pairs: use one of mode fresh")
    return contents
