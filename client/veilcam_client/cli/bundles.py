"""``veilcam bundle``: the bundles of a daemon, over its API."""

from pathlib import Path
from typing import Annotated

import typer

from veilcam_client.camera import Camera
from veilcam_client.cli.format import bundle_in_words
from veilcam_client.cli.terminal import USAGE, Ask, asking, fail
from veilcam_client.wire.bundles import InstalledBundle, InstalledBundles

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
@asking()
def list_bundles(ask: Ask) -> None:
    """Print all bundles; a star stands at the one in use."""
    with ask.camera() as camera:
        _show(ask, camera.bundles.list())


@app.command()
@asking(timeout=120.0)
def install(
    ask: Ask,
    file: Annotated[Path, typer.Argument(help="A bundle, *.veilcam.")],
    *,
    activate: Annotated[bool, typer.Option("--activate", help="Use it from now on.")] = False,
    allow_older: AllowOlder = False,
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

    ask(question, bundle_in_words)


@app.command()
@asking(timeout=120.0)
def activate(ask: Ask, digest: Digest, *, allow_older: AllowOlder = False) -> None:
    """Take masks and classifiers from this bundle from now on."""
    ask(
        lambda camera: camera.bundles.activate(_whole(camera, digest), allow_older=allow_older),
        bundle_in_words,
    )


@app.command()
@asking()
def remove(ask: Ask, digest: Digest) -> None:
    """Remove a bundle that is not in use, for good, and print those that are left."""
    with ask.camera() as camera:
        _show(ask, camera.bundles.remove(_whole(camera, digest)))


def _show(ask: Ask, bundles: InstalledBundles) -> None:
    for installed in bundles.bundles:
        ask.show(installed, bundle_in_words)


def _whole(camera: Camera, start: str) -> str:
    """Return the one digest that begins so."""
    bundles = camera.bundles.list().bundles
    found = [one.digest for one in bundles if one.digest.startswith(start)]
    if len(found) != 1:
        raise ValueError(f"{len(found)} bundles begin with {start!r}: see 'veilcam bundle list'")
    return found[0]
