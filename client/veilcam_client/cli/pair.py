"""``veilcam pair``: from the line that a camera shows to the first array."""

from __future__ import annotations

import sys
from dataclasses import asdict
from typing import Annotated

import typer

from veilcam_client.cli.terminal import (
    USAGE,
    JsonOption,
    TokenFileOption,
    UrlOption,
    camera_of,
    errors,
    fail,
    tell,
)
from veilcam_client.cli.token_words import ROLE_HELP


def pair_command(
    line: Annotated[
        str | None,
        typer.Argument(
            metavar="[LINE]",
            help="Line that 'veilcamd pair' or the camera's page shows, between quotes; - reads it "
            "from the standard input, so that no other user and no history sees it. None: the "
            "camera is asked for one, with an owner's token where it wants tokens.",
        ),
    ] = None,
    *,
    profile: Annotated[
        str | None, typer.Option(help="New name of the profile; the camera's host by default.")
    ] = None,
    label: Annotated[
        str | None, typer.Option(help="Label of this receiver; the machine's name by default.")
    ] = None,
    role: Annotated[
        str | None, typer.Option(help=f"{ROLE_HELP} Without LINE; operator by default.")
    ] = None,
    url: UrlOption = None,
    token_file: TokenFileOption = None,
    json: JsonOption = False,
) -> None:
    """Pair this user with a camera: then 'veilcam capture' and Camera() open its embeddings.

    Key, token and the camera's certificate are kept in a profile beside veilcam/config.toml, which
    this user alone may read. The certificate is compared before anything is sent.
    """
    from veilcam_client.camera import Camera  # noqa: PLC0415 - late, as the next
    from veilcam_client.pairing import pair  # noqa: PLC0415

    if line is not None and (role, url, token_file) != (None, None, None):
        fail("--role, --url and --token-file go without LINE", USAGE)
    with errors():
        if line is None:
            asked = camera_of(url, None, token_file)
            with Camera(profile=asked) as camera:
                offered = camera.receivers.offer(role or "operator")  # type: ignore[arg-type]
            made = pair(offered.line, profile=profile, label=label, url=asked.url)
        else:
            text = sys.stdin.readline() if line == "-" else line
            made = pair(text, profile=profile, label=label)
    named = "" if made.default else f" --profile {made.profile}"
    camera_call = f"Camera({'' if made.default else f'profile={made.profile!r}'})"
    does, python = (
        ("classify", "classify().label")
        if made.role == "viewer"
        else ("capture", "capture().embedding")
    )
    words = [
        f"paired with {made.camera}, as {made.role}",
        f"profile   {made.profile}{', the default' if made.default else ''}",
        f"next      veilcam {does}{named}",
        "or        from veilcam_client import Camera",
        f"          {camera_call}.{python}",
    ]
    tell(asdict(made), "\n".join(words), json=json)
