"""The command line ``veilcam``: ask a camera from a terminal."""

from __future__ import annotations

from collections.abc import Callable
from json import dumps
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from pydantic import ValidationError

from veilcam_client.camera import DEFAULT_URL, Camera
from veilcam_client.cli import bundles, calibrate, tokens
from veilcam_client.cli.format import (
    epoch_in_words,
    event_in_words,
    masks_in_words,
    next_in_words,
    policy_in_words,
    refusal,
    replay_in_words,
)
from veilcam_client.cli.terminal import (
    USAGE,
    JsonOption,
    TimeoutOption,
    UrlOption,
    ask,
    errors,
    fail,
    print_json,
)
from veilcam_client.recording import record as write_recording
from veilcam_client.wire.lease import Lease
from veilcam_client.wire.rotation import (
    EveryCaptures,
    EverySeconds,
    Rotation,
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
    answer = ask(url, timeout, Camera.break_lease if end else Camera.lease_state)
    if json:
        print_json(answer)
    else:
        typer.echo(_in_words(answer))


def _in_words(lease: Lease) -> str:
    if not lease.held or lease.expires_in_s is None:
        return "nobody holds the camera"
    return f"held by {lease.owner!r} for another {lease.expires_in_s:.0f} s"


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


app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    epilog="VEILCAM_TOKEN holds the token for a daemon that wants one, VEILCAM_CA_FILE the "
    "authority of an https one. Exit codes: 2 usage, 3 no connection, 4 timeout, 5 request "
    "refused, 6 busy, 7 device, 8 server defect, 9 unreadable answer, 10 token, 11 scope, "
    "12 leased, 13 recording.",
)
app.command()(calibrate.calibrate)
app.command()(lease)
app.add_typer(tokens.app, name="token")
app.add_typer(bundles.app, name="keyring")
app.command()(record)


@app.callback()
def veilcam() -> None:
    """Ask a Veilcam camera what it sees."""


@app.command()
def status(
    *, url: UrlOption = DEFAULT_URL, timeout: TimeoutOption = 30.0, json: JsonOption = False
) -> None:
    """Show what the camera is and what it is doing."""
    answer = ask(url, timeout, Camera.status)
    if json:
        print_json(answer)
        return
    detail = f" ({answer.detail})" if answer.detail else ""
    rows, columns = answer.bundle.embedding_shape[-2:]
    typer.echo(f"state     {answer.state}{detail}")
    if answer.experiment:
        typer.echo(f"          experiment: {answer.experiment}, labels mean nothing")
    typer.echo(f"device    {answer.device.display}, {answer.device.sensor}")
    masks = masks_in_words(answer.bundle)
    typer.echo(f"task      {answer.bundle.task}, {rows} x {columns}, {masks}")
    typer.echo(f"rotation  {policy_in_words(answer.rotation.policy)}")
    typer.echo(f"epoch     {epoch_in_words(answer.rotation)}")
    typer.echo(f"next      {next_in_words(answer.rotation.preparation)}")
    typer.echo(f"release   {answer.release}")
    typer.echo(f"captures  {answer.captures} in {answer.uptime_s:.0f} s")
    typer.echo(f"version   {answer.version}")


@app.command()
def capture(
    *,
    out: Annotated[Path | None, typer.Option(help="Write the embedding to this .npy file.")] = None,
    url: UrlOption = DEFAULT_URL,
    timeout: TimeoutOption = 30.0,
    json: JsonOption = False,
) -> None:
    """Take one embedding."""
    answer = ask(url, timeout, Camera.capture)
    if out is not None:
        try:
            with out.open("wb") as stream:
                np.save(stream, np.asarray(answer), allow_pickle=False)
        except OSError as error:
            fail(f"cannot write {out}: {error.strerror}", USAGE)
    if json:
        print_json(answer)
        return
    values = np.asarray(answer)
    shape = " x ".join(str(count) for count in values.shape)
    typer.echo(
        f"{answer.id}  epoch {answer.epoch}  {shape} {answer.embedding.form}  "
        f"mean {values.mean():.4g}  {1e3 * answer.timing.total_s:.0f} ms{replay_in_words(answer)}"
    )


@app.command()
def classify(
    *, url: UrlOption = DEFAULT_URL, timeout: TimeoutOption = 30.0, json: JsonOption = False
) -> None:
    """Tell what is in front of the camera."""
    answer = ask(url, timeout, Camera.classify)
    if json:
        print_json(answer)
        return
    typer.echo(
        f"{answer.label}  {100 * answer.confidence:.1f} %  epoch {answer.epoch}  "
        f"{1e3 * answer.timing.total_s:.0f} ms{replay_in_words(answer)}"
    )


@app.command()
def watch(
    *,
    count: Annotated[int | None, typer.Option(min=1, help="Stop after so many events.")] = None,
    since: Annotated[str | None, typer.Option(help="Go on after this event id.")] = None,
    url: UrlOption = DEFAULT_URL,
    timeout: TimeoutOption = 30.0,
    json: JsonOption = False,
) -> None:
    """Print events as they happen, one a line."""
    with errors(), Camera(url, read_timeout=timeout) as camera:
        for number, event in enumerate(camera.events(last_event_id=since), start=1):
            if json:
                print_json(event)
            else:
                typer.echo(f"{event.at:%H:%M:%S}  {event.kind:<14}  {event_in_words(event)}")
            if number == count:
                break


@app.command()
def diagnostics(
    *, url: UrlOption = DEFAULT_URL, timeout: TimeoutOption = 30.0, json: JsonOption = False
) -> None:
    """Show versions, settings, and what failed lately."""
    answer = ask(url, timeout, Camera.diagnostics)
    if json:
        print_json(answer)
        return
    for name, text in answer.versions.items():
        typer.echo(f"version   {name} {text}")
    for name, value in answer.settings.items():
        typer.echo(f"setting   {name} {dumps(value)}")
    for kind, count in answer.events.items():
        typer.echo(f"events    {count} {kind}")
    for past in answer.states:
        why = f": {past.detail}" if past.detail else ""
        typer.echo(f"state     {past.at:%Y-%m-%d %H:%M:%S}  {past.state}{why}")
    for fault in answer.faults:
        typer.echo(f"fault     {fault.at:%Y-%m-%d %H:%M:%S}  {fault.code}: {fault.detail}")


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
    question: Callable[[Camera], Rotation] = Camera.rotate
    if policy is not None:
        wanted = policy

        def question(camera: Camera) -> Rotation:
            return camera.set_rotation(wanted)

    answer = ask(url, timeout, question)
    if json:
        print_json(answer)
        return
    typer.echo(f"rotation  {policy_in_words(answer.policy)}")
    typer.echo(f"epoch     {epoch_in_words(answer)}")


def main() -> None:
    """Run ``veilcam``."""
    app(prog_name="veilcam")
