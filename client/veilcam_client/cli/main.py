"""The command line ``veilcam``: ask a camera from a terminal."""

from dataclasses import asdict
from itertools import islice
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import typer
from pydantic import ValidationError

from veilcam_client.camera import Camera
from veilcam_client.cli import bundles, logs, receivers, tokens
from veilcam_client.cli.calibrate import calibrate
from veilcam_client.cli.collect import collect_command
from veilcam_client.cli.format import (
    capture_in_words,
    classification_in_words,
    dated_in_words,
    diagnostics_in_words,
    lease_in_words,
    refusal,
    rotation_in_words,
    status_in_words,
)
from veilcam_client.cli.pair import pair
from veilcam_client.cli.terminal import (
    EXIT_CODES_HELP,
    USAGE,
    Ask,
    DeviceOption,
    JsonOption,
    KeyOption,
    asking,
    errors,
    fail,
    tell,
    version_option,
)
from veilcam_client.cli.watch import watch
from veilcam_client.numbers import in_blocks, picture
from veilcam_client.recording import record as write_recording
from veilcam_client.wire.rotation import EveryCaptures, EverySeconds, RotationOff, RotationPolicy

app: typer.Typer = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    epilog="VEILCAM_TOKEN holds the token for a daemon that wants one, VEILCAM_CA_FILE the "
    f"authority of an https one. {EXIT_CODES_HELP}",
)


@app.callback()
def veilcam(
    *,
    _: Annotated[bool, version_option("veilcam")] = False,
) -> None:
    """Ask a Veilcam camera what it sees."""


@app.command()
@asking()
def status(ask: Ask) -> None:
    """Show what the camera is and what it is doing."""
    ask(lambda camera: camera.status(), status_in_words)


@app.command()
@asking()
def classify(ask: Ask) -> None:
    """Tell what is in front of the camera."""
    ask(lambda camera: camera.classify(), classification_in_words)


@app.command()
@asking()
def capture(
    ask: Ask,
    *,
    out: Annotated[
        Path | None,
        typer.Option(help="Write the embedding to this file: a picture as .png, else as .npy."),
    ] = None,
    key: KeyOption = None,
    device: DeviceOption = None,
) -> None:
    """Take one embedding."""
    with ask.camera(key=key, device=device) as camera:
        answer = camera.capture()
        if out is not None:
            _save(out, np.asarray(answer))
    ask.show(answer, capture_in_words)


@app.command()
@asking()
def events(
    ask: Ask,
    *,
    count: Annotated[int | None, typer.Option(min=1, help="Stop after so many events.")] = None,
    since: Annotated[str | None, typer.Option(help="Go on after this event id.")] = None,
    pictures: Annotated[
        bool,
        typer.Option(
            "--picture",
            help="With each label or sight that comes, take an embedding and draw it; a token "
            "needs read:embedding.",
        ),
    ] = False,
    key: KeyOption = None,
    device: DeviceOption = None,
) -> None:
    """Print events as they happen, one a line."""
    if pictures and ask.json:
        fail("--picture is for a person, and --json for a program: give one", USAGE)
    with ask.camera(key=key, device=device) as camera:
        for event in islice(camera.events(last_event_id=since), count):
            ask.show(event, dated_in_words)
            if pictures and event.kind in ("classification", "seen", "gone"):
                typer.echo(in_blocks(np.asarray(camera.capture())))


app.command()(watch)


@app.command()
@asking()
def rotate(
    ask: Ask,
    *,
    off: Annotated[bool, typer.Option("--off", help="Keep the mask until told otherwise.")] = False,
    every_seconds: Annotated[
        float | None, typer.Option(help="A new mask every so many seconds.")
    ] = None,
    every_captures: Annotated[
        int | None, typer.Option(help="A new mask every so many captures.")
    ] = None,
    jitter: Annotated[
        float | None, typer.Option(help="Up to so many seconds less, by chance for each mask.")
    ] = None,
    reuse: Annotated[
        int | None,
        typer.Option(help="Captures that a mask may still serve when the next is not ready."),
    ] = None,
) -> None:
    """Show another mask now, or say when masks change."""
    if sum((off, every_seconds is not None, every_captures is not None)) > 1:
        fail("give one of --off, --every-seconds and --every-captures", USAGE)
    if jitter is not None and every_seconds is None:
        fail("--jitter goes with --every-seconds", USAGE)
    if reuse is not None and every_seconds is None and every_captures is None:
        fail("--reuse goes with --every-seconds or --every-captures", USAGE)
    policy: RotationPolicy | None = None
    try:
        if off:
            policy = RotationOff()
        elif every_seconds is not None:
            policy = EverySeconds(seconds=every_seconds, jitter=jitter or 0.0, reuse=reuse or 0)
        elif every_captures is not None:
            policy = EveryCaptures(captures=every_captures, reuse=reuse or 0)
    except ValidationError as error:
        fail(refusal(error), USAGE)
    ask(
        lambda camera: camera.rotation.advance() if policy is None else camera.rotation.set(policy),
        rotation_in_words,
    )


@app.command()
@asking()
def lease(
    ask: Ask,
    *,
    end: Annotated[
        bool,
        typer.Option(
            "--break",
            help="End it, whoever holds the camera: wants the scopes mask:rotate and admin:tokens.",
        ),
    ] = False,
) -> None:
    """Show who holds the camera for a while, or end that."""
    ask(
        lambda camera: camera.lease.revoke() if end else camera.lease.get(),
        lease_in_words,
    )


@app.command()
@asking()
def record(
    ask: Ask,
    *,
    count: Annotated[int, typer.Option(min=1, help="How many captures.")],
    out: Annotated[Path, typer.Option(help="New file, which its owner alone may read.")],
    labels: Annotated[
        bool, typer.Option("--labels", help="Classify each capture, and keep its label.")
    ] = False,
    key: KeyOption = None,
    device: DeviceOption = None,
) -> None:
    """Take captures and write them to a file, for 'veilcamd serve --replay'.

    Sealed ones stay sealed unless --key opens them. A token needs read:status and read:embedding,
    read:embedding:raw where embeddings leave raw, and classify for labels.
    """
    with ask.camera(key=key, device=device) as camera:
        size = write_recording(camera, out, count=count, labels=labels)
    found = {"captures": count, "file": str(out), "bytes": size}
    ask.tell(found, f"wrote {count} captures to {out}, {size / 1e6:.1f} MB")


app.command()(pair)
app.command("collect")(collect_command)
app.command()(calibrate)
app.add_typer(bundles.app, name="bundle")
app.add_typer(receivers.app, name="receiver")
app.add_typer(tokens.app, name="token")
app.command()(logs.log)
app.command()(logs.verify)


@app.command()
@asking()
def diagnostics(ask: Ask) -> None:
    """Show versions, settings, and what failed lately."""
    ask(lambda camera: camera.diagnostics(), diagnostics_in_words)


@app.command()
def discover(
    *,
    seconds: Annotated[float, typer.Option(help="How long to listen.")] = 3.0,
    json: JsonOption = False,
) -> None:
    """Find cameras that announce themselves on the local network; none is asked anything."""
    with errors():
        found = Camera.discover(seconds)
    for each in found:
        tell(asdict(each), f"{each.url}  {each.name}", json=json)
    if not found and not json:
        typer.echo("no camera announces itself here")


def _save(out: Path, values: npt.NDArray[np.float32]) -> None:
    try:
        if out.suffix.lower() == ".png":
            out.write_bytes(picture(values))
            return
        with out.open("wb") as stream:
            np.save(stream, values, allow_pickle=False)
    except OSError as error:
        fail(f"cannot write {out}: {error.strerror}", USAGE)


def main() -> None:
    """Run ``veilcam``."""
    app(prog_name="veilcam")
