"""Common parts of the commands: options, answers, and errors with exit codes."""

import json as encoder
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, NoReturn, TypeVar

import typer
from pydantic import BaseModel

from veilcam_client.camera import Camera
from veilcam_client.cli.profiles import URL
from veilcam_client.errors import (
    AccessError,
    ApiError,
    ArgumentError,
    BusyError,
    ConnectError,
    DeviceError,
    FileError,
    LeasedError,
    ProtocolError,
    RequestTimeoutError,
    SealedError,
    VeilcamError,
)

USAGE, DEVICE = 2, 7
FORGED = 17
"""A log of captures does not hold."""
EXIT_CODES: tuple[tuple[type[VeilcamError], int], ...] = (
    (ArgumentError, USAGE),
    (ConnectError, 3),
    (RequestTimeoutError, 4),
    (BusyError, 6),
    (DeviceError, DEVICE),
    (ProtocolError, 9),
    (AccessError, 10),
    (LeasedError, 12),
    (FileError, 13),
    (SealedError, 15),
    (ApiError, 5),
    (VeilcamError, 1),
)

FoundT = TypeVar("FoundT")
AnswerT = TypeVar("AnswerT", bound=BaseModel)


def _beside_no_profile(context: typer.Context, url: str) -> str:
    """Refuse another camera than that of the profile, whose token it would be told."""
    if context.obj is not None and url != os.environ.get(URL):
        fail(f"give --url or the profile {context.obj!r}, not both", USAGE)
    return url


UrlOption = Annotated[
    str,
    typer.Option(envvar=URL, help="http://HOST:PORT or unix:///PATH.", callback=_beside_no_profile),
]
TimeoutOption = Annotated[float, typer.Option(help="Longest wait for an answer, in seconds.")]
KeyOption = Annotated[
    Path | None,
    typer.Option(help="Private key of a receiver, which opens sealed embeddings."),
]
DeviceOption = Annotated[
    str | None,
    typer.Option(help="Public key that the camera must have, as 'veilcam receiver add' prints it."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")]


def ask(url: str, timeout: float, question: Callable[[Camera], FoundT]) -> FoundT:
    """Ask a camera; exits with the code of what goes wrong."""
    with errors(), Camera(url, read_timeout=timeout) as camera:
        return question(camera)


@contextmanager
def errors() -> Iterator[None]:
    """Say what went wrong, and exit with its code."""
    try:
        yield
    except VeilcamError as error:
        code = next(code for kind, code in EXIT_CODES if isinstance(error, kind))
        hint = f" [{error.code}, request {error.request_id}]" if isinstance(error, ApiError) else ""
        fail(f"{error}{hint}", code)
    except ValueError as error:
        fail(str(error), USAGE)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        # The reader went away: `veilcam watch | head`.
        sys.stderr.close()
        sys.exit(141)


def fail(message: str, code: int) -> NoReturn:
    """Say why, and exit with this code."""
    typer.echo(f"veilcam: error: {message}", err=True)
    sys.exit(code)


def tell(found: Mapping[str, object], in_words: str, *, json: bool) -> None:
    """Print what a command did, as JSON or in words."""
    typer.echo(encoder.dumps(found) if json else in_words)


def show(answer: AnswerT, in_words: Callable[[AnswerT], str], *, json: bool) -> None:
    """Print an answer as it came, or in words."""
    typer.echo(answer.model_dump_json() if json else in_words(answer))
