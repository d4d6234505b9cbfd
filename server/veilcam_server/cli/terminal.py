"""Common parts of the commands: errors in one line, and the place of the state."""

from __future__ import annotations

import getpass
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn, TypeAlias

import typer
from pydantic import ValidationError

from veilcam_server.environment import default_state_dir
from veilcam_server.errors import ProblemError, StartError

if TYPE_CHECKING:
    from veilcam_server.system.state_file import Report

Note: TypeAlias = Callable[[Mapping[str, str]], None]
"""Writes an action to the log, with the user."""

StateDirOption = Annotated[
    Path | None, typer.Option(envvar="VEILCAM_STATE_DIR", help="That of 'veilcamd serve'.")
]

USAGE = 2
"""Exit code where an option or a file cannot be used."""

JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]

_OPTIONS = {"seconds": "every-seconds", "captures": "every-captures"}


def one_line(error: ValidationError) -> str:
    """Name every setting at fault as it is written on the command line."""
    parts = []
    for item in error.errors(include_url=False, include_input=False):
        names = [_OPTIONS.get(str(part), str(part)) for part in item["loc"][:1]]
        name = "".join(f"--{part}".replace("_", "-") for part in names)
        if item["type"] == "missing":
            parts.append(f"{name} is missing: give it, or set it in the environment")
        else:
            message = item["msg"].removeprefix("Value error, ")
            parts.append(f"{name}: {message}" if name else message)
    return "; ".join(parts)


def enter_state(directory: Path) -> None:
    """Take on the owner of a state folder where this is root; end if it cannot be used."""
    # Imported late: --help need not wait for it.
    from veilcam_server.system.state_folder import become_owner, require_usable  # noqa: PLC0415

    try:
        become_owner(directory)
        require_usable(directory)
    except StartError as error:
        fail(str(error))


@contextmanager
def changing_state(state_dir: Path | None) -> Iterator[tuple[Path, Report, Note]]:
    """Yield the state directory, what reports faults of it, and what writes to the log.

    What cannot be done ends the program with a line.

    Args:
        state_dir: directory that was given; None: the default.
    """
    # Imported late: --help need not wait for them, and the folder's owner may not read them.
    from veilcam_server.sealing.identity import DeviceKey  # noqa: PLC0415
    from veilcam_server.security.log import FOLDER, Log  # noqa: PLC0415

    directory = state_dir or default_state_dir()
    user = getpass.getuser()  # before it is the folder's owner
    enter_state(directory)

    def report(fault: ProblemError) -> None:
        typer.echo(str(fault), err=True)

    def note(facts: Mapping[str, str]) -> None:
        with closing(Log(directory / FOLDER, DeviceKey.open(directory))) as log:
            log.append("command", {**facts, "user": user}, durable=True)

    try:
        yield directory, report, note
    except (ProblemError, StartError) as error:
        fail(str(error))


def require_software() -> None:
    """End where this user cannot read the software itself, much of which is imported late."""
    if not os.access(os.__file__, os.R_OK):
        fail(
            f"{getpass.getuser()}, to whom the state directory belongs, cannot read "
            f"{Path(os.__file__).parent}: install veilcam where that user can read it"
        )


def fail(message: str, code: int = 1) -> NoReturn:
    """Say why, and exit with this code."""
    typer.echo(f"veilcamd: error: {message}", err=True)
    raise SystemExit(code)
