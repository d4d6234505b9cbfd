"""``veilcam bundle``: the bundles of a daemon, over its API."""

from pathlib import Path
from typing import Annotated

import typer

from veilcam_client.camera import Camera
from veilcam_client.cli.format import bundle_in_words
from veilcam_client.cli.terminal import (
    USAGE,
    JsonOption,
    TimeoutOption,
    UrlOption,
    ask,
    fail,
    show,
)
from veilcam_client.http.options import DEFAULT_URL
from veilcam_client.wire.bundles import InstalledBundle

app: typer.Typer = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Install, activate and remove them with a token of the scope admin:bundles.",
)

AllowOlder = Annotated[
    bool,
    typer.Option("--allow-older", help="Also if it is of an older version than the one in use."),
]
Digest = Annotated[str, typer.Argument(metavar="DIGEST", help="Its first digits are enough.")]


@app.command("list")
def list_bundles(
    *, url: UrlOption = DEFAULT_URL, timeout: TimeoutOption = 30.0, json: JsonOption = False
) -> None:
    """Print all bundles; a star stands at the one in use."""
    for installed in ask(url, timeout, lambda camera: camera.bundles.list()).bundles:
        show(installed, bundle_in_words, json=json)


@app.command()
def install(
    file: Annotated[Path, typer.Argument(help="A bundle, *.veilcam.")],
    *,
    activate: Annotated[bool, typer.Option("--activate", help="Use it from now on.")] = False,
    allow_older: AllowOlder = False,
    url: UrlOption = DEFAULT_URL,
    timeout: TimeoutOption = 120.0,
    json: JsonOption = False,
) -> None:
    """Hand a bundle over to the daemon, which checks it."""
    if allow_older and not activate:
        fail("--allow-older goes with --activate", USAGE)
    try:
        bundle = file.read_bytes()
    except OSError as error:
        fail(f"{file} cannot be read: {error.strerror}", USAGE)

    def question(camera: Camera) -> InstalledBundle:
        installed = camera.bundles.install(bundle)
        if not activate:
            return installed
        return camera.bundles.activate(installed.digest, allow_older=allow_older)

    show(ask(url, timeout, question), bundle_in_words, json=json)


@app.command()
def activate(
    digest: Digest,
    *,
    allow_older: AllowOlder = False,
    url: UrlOption = DEFAULT_URL,
    timeout: TimeoutOption = 120.0,
    json: JsonOption = False,
) -> None:
    """Take masks and classifiers from this bundle from now on."""

    def question(camera: Camera) -> InstalledBundle:
        return camera.bundles.activate(_whole(camera, digest), allow_older=allow_older)

    show(ask(url, timeout, question), bundle_in_words, json=json)


@app.command()
def remove(
    digest: Digest,
    *,
    url: UrlOption = DEFAULT_URL,
    timeout: TimeoutOption = 30.0,
    json: JsonOption = False,
) -> None:
    """Remove a bundle that is not in use, for good, and print those that are left."""
    left = ask(url, timeout, lambda camera: camera.bundles.remove(_whole(camera, digest)))
    for installed in left.bundles:
        show(installed, bundle_in_words, json=json)


def _whole(camera: Camera, start: str) -> str:
    """Return the one digest that begins so."""
    found = [one.digest for one in camera.bundles.list().bundles if one.digest.startswith(start)]
    if len(found) != 1:
        raise ValueError(f"{len(found)} bundles begin with {start!r}: see 'veilcam bundle list'")
    return found[0]
