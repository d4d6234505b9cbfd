"""``veilcam pair``: from the line that a camera shows to a profile that has all of it."""

from __future__ import annotations

import platform
import re
import sys
from dataclasses import replace
from typing import Annotated

import typer

from veilcam_client.camera import Camera
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
from veilcam_client.profiles import Profile, new_profile
from veilcam_client.wire.pairing import PairingLine


def pair(
    line: Annotated[
        str | None,
        typer.Argument(
            metavar="[LINE]",
            help="Line that 'veilcamd pair' or the camera's page shows, between quotes; - reads it "
            "from the standard input, where no history keeps it. Without LINE the camera is asked "
            "for one, with an owner's token if it wants tokens.",
        ),
    ] = None,
    *,
    profile: Annotated[
        str | None, typer.Option(help="New name of the profile; the camera's host otherwise.")
    ] = None,
    label: Annotated[
        str | None, typer.Option(help="Label of this receiver; this machine's name otherwise.")
    ] = None,
    role: Annotated[
        str | None, typer.Option(help=f"{ROLE_HELP} Without LINE; operator otherwise.")
    ] = None,
    url: UrlOption = None,
    token_file: TokenFileOption = None,
    json: JsonOption = False,
) -> None:
    """Pair this user with a camera: then 'veilcam capture' and Camera() open its embeddings.

    Key, token and certificate are kept in a profile beside veilcam/config.toml, which this user
    alone may read. The certificate is compared before anything is sent.
    """
    # Late: no other command needs it.
    from veilcam_client.keys.receivers import ReceiverKey  # noqa: PLC0415

    if line is not None and (role, url, token_file) != (None, None, None):
        fail("--role, --url and --token-file go without LINE", USAGE)
    with errors():
        if line is None:
            with Camera(profile=camera_of(url, None, token_file)) as camera:
                line = camera.receivers.offer(role or "operator").line  # type: ignore[arg-type]
        asked = PairingLine.parse(sys.stdin.readline() if line == "-" else line)
        # Nothing of another camera: the line alone says whom to trust.
        certificate = None if asked.certificate is None else asked.certificate.hex()
        own, key = Profile(asked.url, certificate=certificate), ReceiverKey.generate()
        label = label or re.sub(r"[^ -~]", "", platform.node())[:64] or "receiver"
        with (
            new_profile(profile or _name(asked), key, exact=profile is not None) as (name, save),
            Camera(profile=own, max_retries=0) as camera,  # a line is used once
        ):
            paired = camera.receivers.claim(asked.secret.hex(), label, key.public)
            default = save(replace(own, token=paired.token, device=paired.device))
    found = {"profile": name, "default": default, "device": paired.device, "role": paired.role}
    does = "classify" if paired.role == "viewer" else "capture"
    words = [
        f"paired with {asked.place} as {paired.role}",
        f"profile: {name}{', the default' if default else ''}",
        f"next:    veilcam {does}{'' if default else f' --profile {name}'}",
        "or:      from veilcam_client import Camera",
        f"         Camera({'' if default else f'profile={name!r}'}).{does}()",
    ]
    tell({**found, "receiver": key.public.id}, "\n".join(words), json=json)


def _name(line: PairingLine) -> str:
    """Return a name for the camera of a line: the first word of its host."""
    if line.certificate is None:
        return "local"
    host = line.place.rpartition(":")[0].strip("[]")
    word = host if re.fullmatch(r"[0-9.]+|.*:.*", host) else host.partition(".")[0]
    return re.sub(r"[^A-Za-z0-9_-]+", "-", word)[:32]
