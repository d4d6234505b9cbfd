"""``veilcam collect``: labelled measurements, for 'veilcam-train adapt'."""

from __future__ import annotations

import shlex
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from veilcam_client.cli.terminal import USAGE, Ask, DeviceOption, KeyOption, asking, fail
from veilcam_client.collecting import Shot, Show, collect, held_before, labelled_pictures, unaided


@asking()
def collect_command(
    ask: Ask,
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Of measurements; gone on with if it is there.")
    ],
    folder: Annotated[
        Path | None, typer.Argument(metavar="[FOLDER]", help="Pictures as FOLDER/LABEL/*.png.")
    ] = None,
    *,
    per_class: Annotated[
        int | None, typer.Option(min=1, help="So many pictures of each label at most.")
    ] = None,
    viewer: Annotated[
        str | None,
        typer.Option(
            help="Command that shows a picture until it is ended, with the file behind it, as in "
            "'feh --fullscreen': for a screen before the camera. Without it pictures are held up "
            "to a simulated camera, with the scope simulate."
        ),
    ] = None,
    pause: Annotated[
        float, typer.Option(min=0, help="Seconds that --viewer takes to show a picture.")
    ] = 1.0,
    key: KeyOption = None,
    device: DeviceOption = None,
) -> None:
    """Measure labelled pictures and write what is measured to a file, each as soon as it is taken.

    Without FOLDER, a person says what is before the camera: a label a line, until an empty one. A
    token needs read:status and read:embedding, and read:embedding:raw where embeddings leave raw.
    The file's measurements are no longer sealed: keep it as you would keep the pictures.
    """
    if folder is None and (per_class is not None or viewer is not None):
        fail("--per-class and --viewer go with FOLDER", USAGE)
    own = ask.profile
    sealed = replace(own, key=None, device=None)  # opened when the key of each mask is kept as well
    with replace(ask, profile=sealed).camera() as camera:
        show: Show = unaided
        if folder is None:
            shots: Iterator[Shot] = _by_hand(camera.status().bundle.labels)
        else:
            shots = iter(labelled_pictures(folder, per_class=per_class))
            show = (
                held_before(camera.simulation)
                if viewer is None
                else _viewed(shlex.split(viewer), pause)
            )
        added = collect(
            camera, file, shots, show=show, key=key or own.key, device=device or own.device
        )
    found = {"added": added, "file": str(file)}
    ask.tell(found, f"{added} measurements more in {file}")


def _by_hand(labels: tuple[str, ...]) -> Iterator[Shot]:
    """Ask a person what is there; a word that is no label is asked for again."""
    while True:
        told = typer.prompt(f"what is before the camera ({', '.join(labels)})", "", err=True)
        if not told:
            return
        if told in labels:
            yield Shot(told)
        else:
            typer.echo(f"{told!r} is none of them", err=True)


def _viewed(command: list[str], pause: float) -> Show:
    """Show pictures on a screen before the camera."""

    @contextmanager
    def show(shot: Shot) -> Iterator[None]:
        try:
            viewer = subprocess.Popen([*command, str(shot.picture)])  # noqa: S603 - as its user says
        except OSError as error:
            fail(f"--viewer {command[0]} cannot be run: {error.strerror}", USAGE)
        try:
            with suppress(subprocess.TimeoutExpired):
                viewer.wait(pause)
                fail(f"--viewer {command[0]} has ended before its picture was measured", USAGE)
            yield
        finally:
            viewer.terminate()
            viewer.wait()

    return show
