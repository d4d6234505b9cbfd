"""Command-line options of settings: name, type, help and default of each are the setting's own."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any, Concatenate, ParamSpec, TypeVar, get_args

import typer
from pydantic import ValidationError
from pydantic.fields import FieldInfo
from pydantic_settings import BaseSettings

from veilcam_client.wire.rotation import EveryCaptures, EverySeconds, RotationOff, RotationPolicy
from veilcam_server.cli.terminal import USAGE, fail, one_line
from veilcam_server.errors import StartError

_Settings = TypeVar("_Settings", bound=BaseSettings)
_Own = ParamSpec("_Own")

_METAVARS = {"scenes": "PATH", "hosts": "NAME", "frame_ancestors": "ORIGIN"}
"""Of options that may be given several times."""


def options_of(
    settings: type[_Settings], names: Collection[str] = ()
) -> Callable[[Callable[Concatenate[_Settings, _Own], None]], Callable[..., None]]:
    """Give a command an option for every setting, and call it with the settings made of them.

    What is not given is taken from the environment; what cannot be ends the program with a line.

    Args:
        settings: the class. Its docstrings are the help.
        names: fields that the command has options for; all of them by default.
    """
    made = [
        option
        for name, field in settings.model_fields.items()
        if not names or name in names
        for option in _options(name, field)
    ]

    def decorate(command: Callable[Concatenate[_Settings, _Own], None]) -> Callable[..., None]:
        own = list(inspect.signature(command, eval_str=True).parameters.values())[1:]

        def run(**given: Any) -> None:
            rest = {parameter.name: given.pop(parameter.name) for parameter in own}
            try:
                checked = settings(**_settings(given))
            except ValidationError as error:
                fail(one_line(error), USAGE)
            except StartError as error:
                fail(str(error), USAGE)
            command(checked, **rest)  # type: ignore[call-arg]

        run.__name__, run.__doc__ = command.__name__, command.__doc__
        parameters = [*made, *own]
        vars(run)["__signature__"] = inspect.Signature(parameters)
        run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return run

    return decorate


def _options(name: str, field: FieldInfo) -> tuple[Parameter, ...]:
    """One; a switch for the device, and for the rotation one for every part of it."""
    if name == "rotation":
        return _ROTATION
    if name == "device":
        return (_parameter("simulate", bool, _text(field)),)
    kind = _kind(field.annotation)
    return (_parameter(name, kind, _help(field), metavar=_METAVARS.get(name)),)


def _kind(annotation: Any) -> Any:
    """Read the options of a terminal: pydantic checks them, and an error is one line."""
    if annotation in (bool, int, float, Path):
        return annotation
    arguments = get_args(annotation)
    if Ellipsis in arguments:
        return list[str]
    return Path if Path in arguments else str


def _help(field: FieldInfo) -> str:
    text, default = _text(field), field.default
    if isinstance(default, bool) or "default" in text:
        return text
    if isinstance(default, (int, float, str, Path)):
        shown = f"{default:g}" if isinstance(default, float) else default
        text += f" Default: {shown}."
    return text


def _text(field: FieldInfo) -> str:
    return " ".join((field.description or "").split())


def _parameter(name: str, kind: Any, text: str, *, metavar: str | None = None) -> Parameter:
    # The name is spelled out: a switch would get a --no-... beside it.
    option = typer.Option(f"--{name.replace('_', '-')}", help=text, metavar=metavar)
    annotation = Annotated[kind | None, option]
    return Parameter(name, Parameter.KEYWORD_ONLY, default=None, annotation=annotation)


_ROTATION = (
    _parameter("every_seconds", float, "Change the mask every so many seconds."),
    _parameter("every_captures", int, "Change the mask every so many captures."),
    _parameter("jitter", float, "With --every-seconds: up to so many seconds less, by chance."),
    _parameter(
        "reuse", int, "Captures that a mask may still serve when the next is not ready; 0 waits."
    ),
    _parameter("rotation_off", bool, "Never change the mask: a lone one needs this."),
)


def _settings(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that were given as options."""
    named = {name: value for name, value in given.items() if value not in (None, [])}
    if named.pop("simulate", False):
        named["device"] = "simulated"
    rotation = {option.name: named.pop(option.name, None) for option in _ROTATION}
    policy = _policy(**rotation)
    return named if policy is None else {**named, "rotation": policy}


def _policy(
    every_seconds: float | None,
    every_captures: int | None,
    jitter: float | None,
    reuse: int | None,
    *,
    rotation_off: bool | None,
) -> RotationPolicy | None:
    if rotation_off:
        if (every_seconds, every_captures, jitter, reuse) != (None, None, None, None):
            raise StartError("with --rotation-off no mask changes: leave out what says when")
        return RotationOff()
    if every_seconds is not None and every_captures is not None:
        raise StartError("give --every-seconds or --every-captures, not both")
    if jitter is not None and every_seconds is None:
        raise StartError("--jitter goes with --every-seconds")
    if reuse is not None and every_seconds is None and every_captures is None:
        raise StartError("--reuse goes with --every-seconds or --every-captures")
    if every_seconds is not None:
        return EverySeconds(seconds=every_seconds, jitter=jitter or 0.0, reuse=reuse or 0)
    if every_captures is not None:
        return EveryCaptures(captures=every_captures, reuse=reuse or 0)
    return None
