"""Common parts of the commands: options, answers, and errors with exit codes."""

import inspect
import json as encoder
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any, Concatenate, NoReturn, ParamSpec, TypeVar

import typer
from pydantic import BaseModel

from veilcam_client.camera import Camera
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
from veilcam_client.http.credentials import read_secret
from veilcam_client.http.options import DEFAULT_URL
from veilcam_client.profiles import Profile, profile_of
from veilcam_client.wire.base import installed_version

EXIT_CODES_HELP = (
    "Exit codes: 0 done, 1 failed, 2 usage or file, 3 no answer, 4 refused, 5 busy or leased, "
    "6 device or unreadable answer, 7 forged log or sealed embedding."
)
"""Of all commands."""
USAGE, DEVICE = 2, 6
FORGED = 7
"""A log does not hold."""
EXIT_CODES: tuple[tuple[type[VeilcamError], int], ...] = (
    (ArgumentError, USAGE),
    (FileError, USAGE),
    (ConnectError, 3),
    (RequestTimeoutError, 3),
    (BusyError, 5),
    (LeasedError, 5),
    (DeviceError, DEVICE),
    (ProtocolError, DEVICE),
    (SealedError, FORGED),
    (AccessError, 4),
    (ApiError, 4),
    (VeilcamError, 1),
)

AnswerT = TypeVar("AnswerT", bound=BaseModel)
P = ParamSpec("P")

UrlOption = Annotated[
    str | None,
    typer.Option(
        help="http://HOST:PORT or unix:///PATH of the camera; that in VEILCAM_URL, of the default "
        f"profile or {DEFAULT_URL} otherwise."
    ),
]
ProfileOption = Annotated[
    str | None,
    typer.Option(
        help="Camera of this name in veilcam/config.toml, or in VEILCAM_PROFILE, instead of --url, "
        "VEILCAM_URL, VEILCAM_TOKEN and VEILCAM_CA_FILE.",
    ),
]
TokenFileOption = Annotated[
    Path | None,
    typer.Option(help="File of the token; that in VEILCAM_TOKEN_FILE otherwise."),
]
TimeoutOption = Annotated[float, typer.Option(help="Longest wait for an answer, in seconds.")]
KeyOption = Annotated[
    Path | None,
    typer.Option(help="Private key of a receiver, for sealed embeddings; that of the profile."),
]
DeviceOption = Annotated[
    str | None,
    typer.Option(help="Public key that the camera must have, as 'veilcam receiver add' prints it."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]


@dataclass(frozen=True, slots=True)
class Ask:
    """Camera that a command asks, and the form of what it prints."""

    profile: Profile
    timeout: float
    json: bool

    @contextmanager
    def camera(self, *, key: Path | None = None, device: str | None = None) -> Iterator[Camera]:
        """Yield the camera; exits with the code of what goes wrong."""
        own, timeout = self.profile, self.timeout
        with errors(), Camera(profile=own, read_timeout=timeout, key=key, device=device) as camera:
            yield camera

    def __call__(
        self, question: Callable[[Camera], AnswerT], in_words: Callable[[AnswerT], str]
    ) -> None:
        """Ask a question, and print the answer."""
        with self.camera() as camera:
            answer = question(camera)
        self.show(answer, in_words)

    def show(self, answer: AnswerT, in_words: Callable[[AnswerT], str]) -> None:
        """Print an answer as it came, or in words."""
        typer.echo(answer.model_dump_json() if self.json else in_words(answer))

    def tell(self, found: Mapping[str, object], in_words: str) -> None:
        """Print what a command did, as JSON or in words."""
        tell(found, in_words, json=self.json)


def asking(
    timeout: float = 30.0,
) -> Callable[[Callable[Concatenate[Ask, P], None]], Callable[..., None]]:
    """Give a command the options of the camera that it asks, and ``--json``.

    Args:
        timeout: longest wait for an answer where no other is given [s].
    """

    def decorate(command: Callable[Concatenate[Ask, P], None]) -> Callable[..., None]:
        own = list(inspect.signature(command, eval_str=True).parameters.values())[1:]

        def run(**given: Any) -> None:
            common = {name: given.pop(name) for name in _COMMON}
            with errors():
                found = camera_of(common["url"], common["profile"], common["token_file"])
            command(Ask(found, common["timeout"], common["json"]), **given)  # type: ignore[call-arg]

        made = [
            Parameter(
                name,
                Parameter.KEYWORD_ONLY,
                default=timeout if name == "timeout" else default,
                annotation=kind,
            )
            for name, (kind, default) in _COMMON.items()
        ]
        parameters = [*own, *made]
        run.__name__, run.__doc__ = command.__name__, command.__doc__
        vars(run)["__signature__"] = inspect.Signature(parameters)
        run.__annotations__ = {each.name: each.annotation for each in parameters}
        return run

    return decorate


_COMMON: Mapping[str, tuple[Any, Any]] = {
    "url": (UrlOption, None),
    "profile": (ProfileOption, None),
    "token_file": (TokenFileOption, None),
    "timeout": (TimeoutOption, 30.0),
    "json": (JsonOption, False),
}


def camera_of(
    url: str | None, profile: str | None, token_file: Path | None, *, local: str = DEFAULT_URL
) -> Profile:
    """Return the camera of these options; raises ArgumentError as :func:`profile_of`."""
    token = None if token_file is None else read_secret(token_file)
    return profile_of(url, profile, local=local, token=token)


def version_option(command: str) -> Any:
    """Return the option ``--version``, which prints the version of a command."""

    def show(wanted: bool) -> None:
        if wanted:
            typer.echo(f"{command} {installed_version()}")
            raise typer.Exit

    return typer.Option("--version", callback=show, is_eager=True, help="Print the version.")


@contextmanager
def errors(command: str = "veilcam") -> Iterator[None]:
    """Say what went wrong, and exit with its code."""
    try:
        yield
    except VeilcamError as error:
        code = next(code for kind, code in EXIT_CODES if isinstance(error, kind))
        hint = f" [{error.code}, request {error.request_id}]" if isinstance(error, ApiError) else ""
        fail(f"{error}{hint}", code, command)
    except ValueError as error:
        fail(str(error), USAGE, command)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        # The reader went away: `veilcam events | head`.
        sys.stderr.close()
        sys.exit(141)


def fail(message: str, code: int, command: str = "veilcam") -> NoReturn:
    """Say why, and exit with this code."""
    typer.echo(f"{command}: error: {message}", err=True)
    sys.exit(code)


def tell(found: Mapping[str, object], in_words: str, *, json: bool) -> None:
    """Print what a command did, as JSON or in words."""
    typer.echo(encoder.dumps(found) if json else in_words)
