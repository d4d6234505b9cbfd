"""``veilcam receiver``: key pairs, and to whom a camera seals its embeddings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError

from veilcam_client.camera import Camera
from veilcam_client.cli.format import receiver_in_words
from veilcam_client.cli.terminal import USAGE, Ask, JsonOption, asking, errors, fail, tell
from veilcam_client.wire.sealing import ReceiverRequest, Receivers

LEAST_DIGITS = 8
"""Of an id, to remove a receiver by."""

app: typer.Typer = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Make a receiver's key pair, and pair receivers with a camera: with a token that has the "
    "scopes admin:receivers and read:status.",
)


@app.command()
def keygen(
    file: Annotated[Path, typer.Argument(help="New file, which its owner alone may read.")],
    *,
    json: JsonOption = False,
) -> None:
    """Write a private key, and print the public one. No camera is asked.

    The private key opens all that is ever sealed to the public one: keep it off the camera.
    """
    # Late: no other command needs it.
    from veilcam_client.keys.receivers import ReceiverKey  # noqa: PLC0415

    with errors():
        key = ReceiverKey.generate()
        key.write(file)
    tell({"public": str(key.public)}, str(key.public), json=json)


@app.command()
@asking()
def add(
    ask: Ask,
    key: Annotated[
        str, typer.Argument(metavar="KEY", help="The public key, or a file that holds it.")
    ],
    *,
    label: Annotated[str, typer.Option(help="For whom or what it is.")],
) -> None:
    """Seal to a receiver from the next mask on, and print the camera's key, for --device."""
    with errors():
        line = _public(key)
    try:
        asked = ReceiverRequest(label=label, key=line)
    except ValidationError as error:
        fail(f"--label: {error.errors()[0]['msg']}", USAGE)

    def question(camera: Camera) -> Receivers:
        camera.receivers.add(asked.label, asked.key)
        return camera.receivers.list()

    ask(question, lambda answer: answer.device)


@app.command("list")
@asking()
def list_receivers(ask: Ask) -> None:
    """Print all receivers, the oldest first."""
    with ask.camera() as camera:
        for receiver in camera.receivers.list().receivers:
            ask.show(receiver, receiver_in_words)


@app.command()
@asking()
def remove(
    ask: Ask,
    receiver_id: Annotated[
        str, typer.Argument(metavar="ID", help=f"Its first {LEAST_DIGITS} digits are enough.")
    ],
) -> None:
    """Seal to a receiver no more, from the next mask on. What it has it still opens."""
    with ask.camera() as camera:
        removed = _whole(camera, receiver_id)
        camera.receivers.remove(removed)
    ask.tell({"removed": removed}, f"removed {removed}")


def _public(key: str) -> str:
    """Return the line itself, checked before anybody is asked."""
    from veilcam_client.keys.receivers import Receiver  # noqa: PLC0415 - as above

    if not key.startswith("veilcam-receiver"):
        try:
            key = Path(key).read_text("ascii", "replace").strip()
        except OSError as error:
            fail(f"{key} cannot be read: {error.strerror}", USAGE)
    return str(Receiver.parse(key))


def _whole(camera: Camera, start: str) -> str:
    """Return the one id that begins so."""
    if len(start) < LEAST_DIGITS:
        raise ValueError(f"{start!r} is too short: give {LEAST_DIGITS} digits or more")
    found = [one.id for one in camera.receivers.list().receivers if one.id.startswith(start)]
    if len(found) != 1:
        raise ValueError(
            f"{len(found)} receivers begin with {start!r}: see 'veilcam receiver list'"
        )
    return found[0]
