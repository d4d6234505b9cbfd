"""``veilcam lease``: who holds the camera, and an end to it."""

from __future__ import annotations

from typing import Annotated

import typer

from veilcam_client.camera import DEFAULT_URL, Camera
from veilcam_client.leases import Lease
from veilcam_client.terminal import JsonOption, TimeoutOption, UrlOption, ask, print_json


def lease(
    *,
    end: Annotated[
        bool,
        typer.Option(
            "--break",
            help="End it, whoever holds the camera: wants the scopes mask:rotate and admin:tokens.",
        ),
    ] = False,
    url: UrlOption = DEFAULT_URL,
    timeout: TimeoutOption = 30.0,
    json: JsonOption = False,
) -> None:
    """Show who holds the camera for a while, or end that."""
    answer = ask(url, timeout, Camera.break_lease if end else Camera.lease_state)
    if json:
        print_json(answer)
    else:
        typer.echo(_in_words(answer))


def _in_words(lease: Lease) -> str:
    if not lease.held or lease.expires_in_s is None:
        return "nobody holds the camera"
    return f"held by {lease.owner!r} for another {lease.expires_in_s:.0f} s"
