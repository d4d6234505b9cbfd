"""The command line ``veilcam``: ask a camera from a terminal."""

from dataclasses import asdict
from itertools import islice
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import typer
from pydantic import ValidationError

from veilcam_client import __version__
from veilcam_client.camera import Camera
from veilcam_client.cli import bundles, calibrate, logs, look, receivers, tokens
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
from veilcam_client.cli.picture import in_blocks
from veilcam_client.cli.profiles import TOKEN, environment, variables_of
from veilcam_client.cli.terminal import (
    USAGE,
    DeviceOption,
    JsonOption,
    KeyOption,
    TimeoutOption,
    UrlOption,
    ask,
    errors,
    fail,
    show,
    tell,
)
from veilcam_client.http.credentials import read_secret
from veilcam_client.http.options import DEFAULT_URL
from veilcam_client.numbers import picture
from veilcam_client.recording import record as write_recording
from veilcam_client.wire.rotation import (
    EveryCaptures,
    EverySeconds,
    RotationOff,
    RotationPolicy,
)


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
    answer = ask(url, timeout, lambda camera: camera.lease.revoke() if end else camera.lease.get())
    show(answer, lease_in_words, json=json)


def record(
    *,
    count: Annotated[int, typer.Option(min=1, help="How many captures.")],
    out: Annotated[Path, typer.Option(help="New file, which its owner alone may read.")],
    labels: Annotated[
        bool, typer.Option("--labels", help="Classify each capture, and keep its label.")
    ] = False,
    key: KeyOption = None,
    device: DeviceOption = None,
    url: UrlOption = DEFAULT_URL,
    timeout: TimeoutOption = 30.0,
    json: JsonOption = False,
) -> None:
    """Take captures and write them to a file, for 'veilcamd serve --replay'.

    Sealed ones stay sealed unless --key opens them. A token needs read:status and read:embedding,
    read:embedding:raw where embeddings leave raw, and classify for labels.
    """
    with errors(), Camera(url, read_timeout=timeout, key=key, device=device) as camera:
        size = write_recording(camera, out, count=count, labels=labels)
    found = {"captures": count, "file": str(out), "bytes": size}
    tell(found, f"wrote {count} captures to {out}, {size / 1e6:.1f} MB", json=json)


app: typer.Typer = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    epilog="VEILCAM_TOKEN holds the token for a daemon that wants one, VEILCAM_CA_FILE the "
    "authority of an https one. Exit codes: 2 usage, 3 no connection, 4 timeout, 5 request "
    "refused, 6 busy, 7 device, 8 server defect, 9 unreadable answer, 10 token, 11 scope, "
    "12 leased, 13 recording, 14 key, 15 sealed, 16 log file, 17 log that does not hold, "
    "18 discovery, 19 pulling a bundle.",
)
app.command()(calibrate.calibrate)
app.command()(lease)
app.command()(look.look)
app.add_typer(tokens.app, name="token")
app.add_typer(bundles.app, name="bundle")
app.add_typer(receivers.app, name="receiver")
app.command()(record)
app.command("collect")(collect_command)
app.command()(logs.log)
app.command()(logs.verify)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"veilcam {__version__}")
        raise typer.Exit


@app.callback()
def veilcam(
    context: typer.Context,
    *,
    profile: Annotated[
        str | None,
        typer.Option(
            envvar="VEILCAM_PROFILE",
            help="Camera of this name in veilcam/config.toml, instead of --url, VEILCAM_URL, "
            "VEILCAM_TOKEN and VEILCAM_CA_FILE.",
        ),
    ] = None,
    token_file: Annotated[
        Path | None,
        typer.Option(envvar="VEILCAM_TOKEN_FILE", help="File of the token."),
    ] = None,
    _: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    """Ask a Veilcam camera what it sees."""
    with errors():
        variables = {} if profile is None else variables_of(profile)
        if token_file is not None:
            variables[TOKEN] = read_secret(token_file)
    context.obj = profile
    context.with_resource(environment(variables))


@app.command()
def status(
    *, url: UrlOption = DEFAULT_URL, timeout: TimeoutOption = 30.0, json: JsonOption = False
) -> None:
    """Show what the camera is and what it is doing."""
    show(ask(url, timeout, Camera.status), status_in_words, json=json)


@app.command()
def capture(
    *,
    out: Annotated[
        Path | None,
        typer.Option(help="Write the embedding to this file: a picture as .png, else as .npy."),
    ] = None,
    key: KeyOption = None,
    device: DeviceOption = None,
    url: UrlOption = DEFAULT_URL,
    timeout: TimeoutOption = 30.0,
    json: JsonOption = False,
) -> None:
    """Take one embedding."""
    with errors(), Camera(url, read_timeout=timeout, key=key, device=device) as camera:
        answer = camera.capture()
        if out is not None:
            _save(out, np.asarray(answer))
    show(answer, capture_in_words, json=json)


@app.command()
def classify(
    *, url: UrlOption = DEFAULT_URL, timeout: TimeoutOption = 30.0, json: JsonOption = False
) -> None:
    """Tell what is in front of the camera."""
    show(ask(url, timeout, Camera.classify), classification_in_words, json=json)


@app.command()
def watch(
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
    url: UrlOption = DEFAULT_URL,
    timeout: TimeoutOption = 30.0,
    json: JsonOption = False,
) -> None:
    """Print events as they happen, one a line."""
    if pictures and json:
        fail("--picture is for a person, and --json for a program: give one", USAGE)
    with errors(), Camera(url, read_timeout=timeout, key=key, device=device) as camera:
        for event in islice(camera.events(last_event_id=since), count):
            show(event, dated_in_words, json=json)
            if pictures and event.kind in ("classification", "seen", "gone"):
                typer.echo(in_blocks(np.asarray(camera.capture())))


@app.command()
def diagnostics(
    *, url: UrlOption = DEFAULT_URL, timeout: TimeoutOption = 30.0, json: JsonOption = False
) -> None:
    """Show versions, settings, and what failed lately."""
    show(ask(url, timeout, Camera.diagnostics), diagnostics_in_words, json=json)


@app.command()
def rotate(
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
    url: UrlOption = DEFAULT_URL,
    timeout: TimeoutOption = 30.0,
    json: JsonOption = False,
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
    answer = ask(
        url,
        timeout,
        lambda camera: camera.rotation.advance() if policy is None else camera.rotation.set(policy),
    )
    show(answer, rotation_in_words, json=json)


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
