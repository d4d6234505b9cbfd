"""``veilcam-train predict``: labels of picture files."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from veilcam_training.bundle import read_bundle
from veilcam_training.data.folders import shown
from veilcam_training.experiments.predict import find_pictures, predict


def predict_command(
    bundle: Annotated[Path, typer.Argument(help="A bundle, *.veilcam.")],
    pictures: Annotated[list[Path], typer.Argument(help="Picture files, or folders of them.")],
) -> None:
    """Print the label and the confidence of each picture, as a simulated camera tells them.

    Without a terminal a line is path, label and confidence (0 to 1), with tabs between them.
    """
    found = find_pictures(pictures)
    for each in predict(read_bundle(bundle), found):
        path, share = shown(each.path), each.confidence
        if sys.stdout.isatty():
            typer.echo(f"{path}: {each.label} ({100 * share:.1f} %)")
        else:
            typer.echo(f"{path}\t{each.label}\t{share:.2f}")
