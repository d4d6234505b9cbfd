"""Command line ``veilcam-optics``."""

import typer

from veilcam_optics.cli.camera import print_camera
from veilcam_optics.cli.plan import print_plan

app = typer.Typer(
    help="Optics of a lensless camera.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    # Units stand in brackets, which markup takes for its own and leaves out.
    rich_markup_mode=None,
)
app.command("plan")(print_plan)
app.command("camera")(print_camera)


@app.callback()
def _group() -> None:
    """Optics of a lensless camera."""


def main() -> None:
    """Run the command line."""
    app()
