"""``veilcam record``: keep what a camera answers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from veilcam_client.camera import DEFAULT_URL, Camera
from veilcam_client.recording import record as write_recording
from veilcam_client.terminal import TimeoutOption, UrlOption, errors


def record(
    *,
    count: Annotated[int, typer.Option(min=1, help="How many captures.")],
    out: Annotated[Path, typer.Option(help="New file, which its owner alone may read.")],
    labels: Annotated[
        bool, typer.Option("--labels", help="Classify each capture, and keep its label.")
    ] = False,
    url: UrlOption = DEFAULT_URL,
    timeout: TimeoutOption = 30.0,
) -> None:
    """Take captures and write them to a file, for 'veilcamd serve --replay'.

    A token needs read:status and read:embedding, read:embedding:raw where embeddings leave raw, and
    classify for labels.
    """
    with errors(), Camera(url, read_timeout=timeout) as camera:
        size = write_recording(camera, out, count=count, labels=labels)
    typer.echo(f"wrote {count} captures to {out}, {size / 1e6:.1f} MB")
