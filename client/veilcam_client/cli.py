"""The command line ``veilcam``: ask a camera from a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, NoReturn, TypeVar

import numpy as np
import typer
from pydantic import BaseModel, ValidationError

from veilcam_client.camera import DEFAULT_URL, Camera
from veilcam_client.errors import (
    ApiError,
    BusyError,
    ConnectError,
    DeviceError,
    InvalidRequestError,
    ProtocolError,
    RequestTimeoutError,
    ServerError,
    VeilcamError,
)
from veilcam_client.models import (
    EveryCaptures,
    EverySeconds,
    Rotation,
    RotationOff,
    RotationPolicy,
)
from veilcam_client.wording import (
    epoch_in_words,
    event_in_words,
    masks_in_words,
    next_in_words,
    policy_in_words,
    refusal,
)

EXIT_CODES: tuple[tuple[type[VeilcamError], int], ...] = (
    (ConnectError, 3),
    (RequestTimeoutError, 4),
    (InvalidRequestError, 5),
    (BusyError, 6),
    (DeviceError, 7),
    (ServerError, 8),
    (ProtocolError, 9),
)
USAGE = 2

AnswerT = TypeVar("AnswerT", bound=BaseModel)

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    epilog="Exit codes: 2 usage, 3 no connection, 4 timeout, 5 request refused, 6 busy, "
    "7 device, 8 server defect, 9 unreadable answer.",
)

UrlOption = Annotated[
    str,
    typer.Option(envvar="VEILCAM_URL", help="http://HOST:PORT or unix:///PATH."),
]
TimeoutOption = Annotated[float, typer.Option(help="Longest wait for an answer [s].")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")]


@app.callback()
def veilcam() -> None:
    """Ask a Veilcam camera what it sees."""


@app.command()
def status(
    *, url: UrlOption = DEFAULT_URL, timeout: TimeoutOption = 30.0, json: JsonOption = False
) -> None:
    """Show what the camera is and what it is doing."""
    answer = _ask(url, timeout, Camera.status)
    if json:
        _print_json(answer)
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
    answer = _ask(url, timeout, Camera.capture)
    if out is not None:
        try:
            with out.open("wb") as stream:
                np.save(stream, np.asarray(answer), allow_pickle=False)
        except OSError as error:
            _fail(f"cannot write {out}: {error.strerror}", USAGE)
    if json:
        _print_json(answer)
        return
    values = np.asarray(answer)
    shape = " x ".join(str(count) for count in values.shape)
    typer.echo(
        f"{answer.id}  epoch {answer.epoch}  {shape} {answer.embedding.form}  "
        f"mean {values.mean():.4g}  {1e3 * answer.timing.total_s:.0f} ms"
    )


@app.command()
def classify(
    *, url: UrlOption = DEFAULT_URL, timeout: TimeoutOption = 30.0, json: JsonOption = False
) -> None:
    """Tell what is in front of the camera."""
    answer = _ask(url, timeout, Camera.classify)
    if json:
        _print_json(answer)
        return
    typer.echo(
        f"{answer.label}  {100 * answer.confidence:.1f} %  epoch {answer.epoch}  "
        f"{1e3 * answer.timing.total_s:.0f} ms"
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
    with _errors(), Camera(url, read_timeout=timeout) as camera:
        for number, event in enumerate(camera.events(last_event_id=since), start=1):
            if json:
                _print_json(event)
            else:
                typer.echo(f"{event.at:%H:%M:%S}  {event.kind:<14}  {event_in_words(event)}")
            if number == count:
                break


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
        _fail("give one of --off, --every-seconds and --every-captures", USAGE)
    if jitter is not None and every_seconds is None:
        _fail("--jitter goes with --every-seconds", USAGE)
    if reuse is not None and every_seconds is None and every_captures is None:
        _fail("--reuse goes with --every-seconds or --every-captures", USAGE)
    policy: RotationPolicy | None = None
    try:
        if off:
            policy = RotationOff()
        elif every_seconds is not None:
            policy = EverySeconds(seconds=every_seconds, jitter=jitter or 0.0, reuse=reuse or 0)
        elif every_captures is not None:
            policy = EveryCaptures(captures=every_captures, reuse=reuse or 0)
    except ValidationError as error:
        _fail(refusal(error), USAGE)
    ask: Callable[[Camera], Rotation] = Camera.rotate
    if policy is not None:
        wanted = policy

        def ask(camera: Camera) -> Rotation:
            return camera.set_rotation(wanted)

    answer = _ask(url, timeout, ask)
    if json:
        _print_json(answer)
        return
    typer.echo(f"rotation  {policy_in_words(answer.policy)}")
    typer.echo(f"epoch     {epoch_in_words(answer)}")


def main() -> None:
    """Run ``veilcam``."""
    app(prog_name="veilcam")


def _ask(url: str, timeout: float, ask: Callable[[Camera], AnswerT]) -> AnswerT:
    with _errors(), Camera(url, read_timeout=timeout) as camera:
        return ask(camera)


@contextmanager
def _errors() -> Iterator[None]:
    try:
        yield
    except VeilcamError as error:
        code = next(code for kind, code in EXIT_CODES if isinstance(error, kind))
        hint = f" [{error.code}, request {error.request_id}]" if isinstance(error, ApiError) else ""
        _fail(f"{error}{hint}", code)
    except ValueError as error:
        _fail(str(error), USAGE)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        # The reader went away: `veilcam watch | head`.
        sys.stderr.close()
        sys.exit(141)


def _fail(message: str, code: int) -> NoReturn:
    typer.echo(f"veilcam: error: {message}", err=True)
    sys.exit(code)


def _print_json(answer: BaseModel) -> None:
    typer.echo(answer.model_dump_json())
