"""The command line ``veilcamd``."""

from __future__ import annotations

import json as encoder
import secrets
import sys
from pathlib import Path
from typing import Annotated

import typer

from veilcam_client import __version__
from veilcam_server.cli import calibrate, doctor, pair, privacy, serve, state, tokens
from veilcam_server.cli.terminal import JsonOption, enter_state, fail
from veilcam_server.demo_data import DIGITS, load_digits
from veilcam_server.environment import default_state_dir
from veilcam_server.errors import StartError
from veilcam_server.settings import SCENE_NAME

app = typer.Typer(
    no_args_is_help=True,
    # Local variables hold masks: they must not end up in a terminal.
    pretty_exceptions_enable=False,
    # Help in plain text: what draws boxes around it takes longer to load than all else.
    rich_markup_mode=None,
)
app.command()(serve.serve)
app.command()(doctor.doctor)
app.command()(privacy.privacy)
app.add_typer(tokens.app, name="token")
app.command()(pair.pair)
app.command()(calibrate.calibrate)
for command in (state.backup, state.restore, state.wipe):
    app.command()(command)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"veilcamd {__version__}")
        raise typer.Exit


@app.callback()
def veilcamd(
    *,
    _: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    """Run the Veilcam daemon: a privacy camera without a lens."""


@app.command()
def show(
    *,
    scene: Annotated[
        Path | None,
        typer.Option(help="File that the simulated camera sees; the one of 'serve' by default."),
    ] = None,
    digit: Annotated[
        int | None, typer.Option(min=0, max=9, help="Any held-out digit of this kind.")
    ] = None,
    index: Annotated[int | None, typer.Option(min=0, help="Exactly this held-out digit.")] = None,
    json: JsonOption = False,
) -> None:
    """Hold a handwritten digit up in front of a simulated camera."""
    try:
        digits = load_digits()
        if index is not None and index >= len(digits):
            raise StartError(f"--index {index}: there are {len(digits)} digits, from 0 on")
        if index is None:
            fitting = [n for n, label in enumerate(digits.labels) if digit in (None, label)]
            index = secrets.choice(fitting)
        if scene is None:
            enter_state(default_state_dir())
        path = scene or default_state_dir() / SCENE_NAME
        serve.set_scene(path, digits, index)
        held = {"digit": int(digits.labels[index]), "index": index, "file": str(path)}
        words = f"held up a {held['digit']} (held-out digit {index}) in {path}"
        typer.echo(encoder.dumps(held) if json else words)
    except StartError as error:
        fail(str(error))


@app.command()
def demo(
    *,
    captures: Annotated[int, typer.Option(min=1, help="How many digits to show.")] = 200,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Draw every mask from a key; no mask is used again.")
    ] = False,
    every: Annotated[
        int | None, typer.Option(min=1, help="Captures under one mask: 10, with --fresh 1.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Directory for report.png.")] = Path("demo"),
    bundle: Annotated[
        Path | None, typer.Option(help="Masks and classifiers, instead of those that come along.")
    ] = None,
    digits: Annotated[Path, typer.Option(help="Held-out digits.")] = DIGITS,
    seed: Annotated[int, typer.Option(min=0, help="Chooses the digits.")] = 0,
    wrong_classifier: Annotated[
        bool,
        typer.Option(
            "--wrong-classifier",
            help="Read every mask as if it were another one: accuracy collapses.",
        ),
    ] = False,
) -> None:
    """Classify handwritten digits through changing masks, end to end."""
    # Imported late: --help need not wait for torch and matplotlib.
    from rich.console import Console  # noqa: PLC0415

    from veilcam_client import VeilcamError  # noqa: PLC0415
    from veilcam_server.demo.run import Plan, demonstrate  # noqa: PLC0415

    plan = Plan(
        fresh=fresh,
        bundle=bundle,
        digits=digits,
        out=out,
        captures=captures,
        every=every,
        seed=seed,
        wrong_classifier=wrong_classifier,
    )
    try:
        typer.echo(demonstrate(plan, Console()).summary())
    except (StartError, VeilcamError) as error:
        fail(str(error))
    except KeyboardInterrupt:
        raise SystemExit(130) from None


def main() -> None:
    """Run ``veilcamd``."""
    app(prog_name="veilcamd")
    sys.exit(0)
