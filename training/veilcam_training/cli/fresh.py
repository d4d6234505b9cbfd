"""``veilcam-train frame``: what decoding elsewhere needs."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from veilcam_optics.decoding import write_frame
from veilcam_training.bundle import read_bundle
from veilcam_training.errors import TrainingError
from veilcam_training.files import check_file

console = Console()


def frame_command(
    bundle: Annotated[Path, typer.Argument(help="Bundle of mode fresh.")],
    out: Annotated[Path, typer.Argument(help="Frame to write, *.safetensors.")],
) -> None:
    """Write what decoding elsewhere needs besides the key of a mask; none of it is secret."""
    contents = read_bundle(bundle)
    if contents.fresh is None:
        raise TrainingError(f"{bundle} holds pairs: use a bundle of mode fresh")
    check_file("OUT", out, ".safetensors")
    write_frame(out, contents.fresh.frame(contents.camera, contents.scene, contents.embedding))
    console.print(f"wrote {out}")
