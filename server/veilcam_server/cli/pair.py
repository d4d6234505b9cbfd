"""``veilcamd pair``: one line that pairs a receiver with the daemon of this machine."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Annotated

import typer
from pydantic import ValidationError

from veilcam_client.cli.token_words import ROLE_HELP
from veilcam_client.wire.pairing import OFFER_SECONDS, PairingOffer, PairingRequest
from veilcam_server.cli.terminal import (
    USAGE,
    JsonOption,
    StateDirOption,
    changing_state,
    fail,
    one_line,
)
from veilcam_server.errors import StartError


def pair(
    *,
    role: Annotated[str, typer.Option(help=ROLE_HELP)] = "operator",
    state_dir: StateDirOption = None,
    json: JsonOption = False,
) -> None:
    """Print a line that pairs one receiver with the daemon that runs here, for five minutes.

    Whoever has the line takes a token of the role with it: 'veilcam pair LINE' on the receiver's
    machine. It ends the line before, and three wrong tries end it.
    """
    from veilcam_server.security.pairing import PairingOffers  # noqa: PLC0415 - --help need not
    from veilcam_server.system.listeners import running_daemon  # noqa: PLC0415 - wait for them

    try:
        asked = PairingRequest.model_validate({"role": role})
    except ValidationError as error:
        fail(one_line(error), USAGE)
    with changing_state(state_dir) as (directory, report, note):
        daemon = running_daemon(directory)
        if not daemon.pairs:
            raise StartError("this daemon pairs nobody: start it without --release none")
        digest = daemon.certificate
        certificate = None if digest is None else bytes.fromhex(digest)
        offers = PairingOffers(directory, certificate=certificate, report=report)
        made = offers.make(daemon.place, asked.role)
        note({"action": "pair", "role": made.role})
    _tell(made, json=json)


def _tell(made: PairingOffer, *, json: bool) -> None:
    if json:
        typer.echo(made.model_dump_json())
        return
    typer.echo(made.line)
    if sys.stdout.isatty():
        typer.echo("\n".join(_drawn(made.line)))
    typer.echo(
        f"valid once, for {OFFER_SECONDS // 60} minutes: on the receiver's machine, run "
        "veilcam pair 'LINE'",
        err=True,
    )


def _drawn(line: str) -> Iterator[str]:
    """Yield a line's QR code for a terminal, two rows in each line, in black and white."""
    import segno  # noqa: PLC0415 - --help need not wait for it

    rows = [bytes(row) for row in segno.make_qr(line).matrix_iter(border=4)]
    rows.append(bytes(len(rows)))  # their number is odd
    for upper, lower in zip(rows[::2], rows[1::2], strict=True):
        blocks = (
            f"\x1b[{30 if top else 97};{40 if bottom else 107}m\u2580"
            for top, bottom in zip(upper, lower, strict=True)
        )
        yield f"{''.join(blocks)}\x1b[0m"
