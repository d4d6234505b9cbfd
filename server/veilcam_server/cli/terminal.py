"""Common parts of the commands: errors in one line, and the place of the state."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NoReturn

import typer
from pydantic import ValidationError

StateDirOption = Annotated[
    Path | None, typer.Option(envvar="VEILCAM_STATE_DIR", help="That of 'veilcamd serve'.")
]

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


def fail(message: str) -> NoReturn:
    """Say why, and exit with 1."""
    typer.echo(f"veilcamd: error: {message}", err=True)
    raise SystemExit(1)
