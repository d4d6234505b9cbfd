"""``veilcam-optics camera``: a preset as a TOML file, to be changed and read again."""

from enum import StrEnum
from typing import Annotated

import typer

from veilcam_optics.camera.description import describe_camera
from veilcam_optics.camera.presets import PRESETS


class PresetName(StrEnum):
    """The presets by name."""

    paper = "paper"
    slm = "slm"
    dmd = "dmd"


def print_camera(
    name: Annotated[PresetName, typer.Argument(help="Which camera.")],
) -> None:
    """Print a camera as TOML, with sources, units and ranges."""
    chosen = PRESETS[name.value]
    typer.echo(f"# {chosen.source}")
    typer.echo(describe_camera(chosen.camera), nl=False)
