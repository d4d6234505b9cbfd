"""``veilcam-train export``: classifiers for other software."""

import shlex
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from veilcam_training.bundle import read_bundle
from veilcam_training.experiments.records import own_command
from veilcam_training.export.files import export_bundle

console = Console(soft_wrap=True, highlight=False)


def export_command(
    bundle: Annotated[Path, typer.Argument(help="A bundle, *.veilcam; it stays as it is.")],
    *,
    out: Annotated[Path, typer.Option("--out", help="Folder to write into.")],
) -> None:
    """Write a bundle's classifiers as ONNX and safetensors, with a model card.

    Masks are not written. Needs the extra export.
    """
    for path in export_bundle(read_bundle(bundle), out, shlex.join(own_command())):
        console.print(f"wrote {path}", markup=False)
