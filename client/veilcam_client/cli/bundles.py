"""``veilcam keyring``: the keyrings of a daemon, over its API."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from veilcam_client.camera import DEFAULT_URL, Camera
from veilcam_client.cli.format import keyring_in_words
from veilcam_client.cli.terminal import (
    USAGE,
    JsonOption,
    TimeoutOption,
    UrlOption,
    ask,
    fail,
    show,
)
from veilcam_client.wire.bundles import Keyring

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Install, activate and remove keyrings, with a token of the scope admin:keyring.",
)

Digest = Annotated[str, typer.Argument(metavar="DIGEST", help="Its first digits are enough.")]


@app.command("list")
def list_keyrings(
    *, url: UrlOption = DEFAULT_URL, timeout: TimeoutOption = 30.0, json: JsonOption = False
) -> None:
    """Print all keyrings; a star stands at the one in use."""
    for keyring in ask(url, timeout, Camera.keyrings):
        show(keyring, keyring_in_words, json=json)


@app.command()
def install(
    file: Annotated[Path, typer.Argument(help="A bundle, *.veilcam.")],
    *,
    activate: Annotated[bool, typer.Option("--activate", help="Use it from now on.")] = False,
    url: UrlOption = DEFAULT_URL,
    timeout: TimeoutOption = 120.0,
    json: JsonOption = False,
) -> None:
    """Hand a bundle over to the daemon, which checks it."""
    try:
        bundle = file.read_bytes()
    except OSError as error:
        fail(f"{file} cannot be read: {error.strerror}", USAGE)

    def question(camera: Camera) -> Keyring:
        keyring = camera.install_keyring(bundle)
        return camera.activate_keyring(keyring.digest) if activate else keyring

    show(ask(url, timeout, question), keyring_in_words, json=json)


@app.command()
def activate(
    digest: Digest,
    *,
    url: UrlOption = DEFAULT_URL,
    timeout: TimeoutOption = 120.0,
    json: JsonOption = False,
) -> None:
    """Take masks and classifiers from this keyring from now on."""
    answer = ask(url, timeout, lambda camera: camera.activate_keyring(_whole(camera, digest)))
    show(answer, keyring_in_words, json=json)


@app.command()
def remove(
    digest: Digest,
    *,
    url: UrlOption = DEFAULT_URL,
    timeout: TimeoutOption = 30.0,
    json: JsonOption = False,
) -> None:
    """Remove a keyring that is not in use, for good, and print those that are left."""
    left = ask(url, timeout, lambda camera: camera.remove_keyring(_whole(camera, digest)))
    for keyring in left:
        show(keyring, keyring_in_words, json=json)


def _whole(camera: Camera, start: str) -> str:
    """The one digest that begins so."""
    found = [one.digest for one in camera.keyrings() if one.digest.startswith(start)]
    if len(found) != 1:
        raise ValueError(f"{len(found)} keyrings begin with {start!r}: see 'veilcam keyring list'")
    return found[0]
