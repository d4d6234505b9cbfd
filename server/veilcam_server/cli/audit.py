"""``veilcamd audit``: print who did what."""

from __future__ import annotations

import json as encoder
from typing import Annotated, Any

import typer

from veilcam_server.cli.terminal import JsonOption, StateDirOption, enter_state, fail
from veilcam_server.environment import default_state_dir
from veilcam_server.errors import StartError


def audit(
    *,
    refused: Annotated[
        bool, typer.Option("--refused", help="What was asked without a valid token instead.")
    ] = False,
    last: Annotated[int, typer.Option(min=1, help="So many entries at most.")] = 1000,
    state_dir: StateDirOption = None,
    json: JsonOption = False,
) -> None:
    """Print who did what, the latest last."""
    # Imported late: --help need not wait for it.
    from veilcam_server.security.audit import DONE, REFUSED, read_audit  # noqa: PLC0415

    directory = state_dir or default_state_dir()
    enter_state(directory)
    try:
        entries = read_audit(directory / (REFUSED if refused else DONE))
    except StartError as error:
        fail(str(error))
    for entry in entries[-last:]:
        typer.echo(encoder.dumps(entry) if json else _in_words(entry))


def _in_words(entry: dict[str, Any]) -> str:
    at = str(entry["at"])[:19].replace("T", " ")
    outcome = entry.get("code") or entry.get("status", "")
    by = next((name for name in ("user", "label", "peer") if name in entry), "")
    who = entry.get(by, "the daemon")
    known = ("at", "action", "code", "status", "peer", by)
    rest = "  ".join(f"{name} {value}" for name, value in entry.items() if name not in known)
    return f"{at}  {who:<16}  {entry['action']:<34}  {outcome!s:<20}  {rest}".rstrip()
