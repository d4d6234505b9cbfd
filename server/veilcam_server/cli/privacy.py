"""``veilcamd privacy``: what somebody can learn from the camera as it is set up."""

from __future__ import annotations

from pathlib import Path

import typer

from veilcam_server.cli.options import options_of
from veilcam_server.cli.terminal import JsonOption
from veilcam_server.settings import Settings


class _Settings(Settings):
    bundle: Path = Path()  # of no matter here


@options_of(_Settings, ("release", "beat", "full_scores"))
def privacy(settings: _Settings, *, json: JsonOption = False) -> None:
    """Say what somebody can learn from this camera: who, what, the measured figure, the switch.

    Settings are those of the environment, as for 'serve', or given here.
    """
    # Imported late: --help need not wait for them.
    from veilcam_server.security.privacy import privacy_of  # noqa: PLC0415

    found = privacy_of(
        settings.release or "sealed", beat=settings.beat == "on", full_scores=settings.full_scores
    )
    if json:
        typer.echo(found.model_dump_json(indent=2))
        return
    for each in found.observers:
        typer.secho(f"Who {each.who}", bold=True)
        for name, text in (
            ("learns", each.learns),
            ("measured", each.measured),
            ("switch", each.switch),
        ):
            typer.echo(f"  {name:9} {text.replace('`', '')}")
