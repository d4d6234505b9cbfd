"""``veilcam token``: the tokens of a daemon, over its API."""

from typing import Annotated

import typer

from veilcam_client.cli.terminal import Ask, asking, errors
from veilcam_client.cli.token_words import (
    DaysOption,
    LabelOption,
    RoleOption,
    ScopeOption,
    asked_token,
    token_in_words,
)
from veilcam_client.wire.tokens import TOKENS_AT_ONCE

app: typer.Typer = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Make, list and revoke tokens, with an owner's. The first one is made on the device: "
    "'veilcamd token first'.",
)


@app.command()
@asking()
def create(
    ask: Ask,
    *,
    label: LabelOption,
    role: RoleOption = None,
    scope: ScopeOption = None,
    days: DaysOption = None,
) -> None:
    """Make a token and print it. It is shown this once."""
    with errors():
        asked = asked_token(label, role, scope, days)
    ask(
        lambda camera: camera.tokens.create(
            asked.label, asked.scopes, role=asked.role, seconds=asked.seconds
        ),
        lambda made: made.secret,
    )


@app.command("list")
@asking()
def list_tokens(
    ask: Ask,
    *,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Print so many at most, the oldest first.")
    ] = None,
    after: Annotated[
        str | None, typer.Option(metavar="ID", help="Print those that are newer than this one.")
    ] = None,
) -> None:
    """Print all tokens, or some, without their secrets."""
    left = float("inf") if limit is None else limit
    with ask.camera() as camera:
        while left > 0:
            wanted = int(min(left, TOKENS_AT_ONCE))
            page = camera.tokens.list(limit=wanted, after=after)
            for token in page.tokens:
                ask.show(token, token_in_words)
            if page.next is None:
                return
            after, left = page.next, left - wanted


@app.command()
@asking()
def revoke(
    ask: Ask,
    token_id: Annotated[
        str, typer.Argument(metavar="ID", help="As 'veilcam token list' names it.")
    ],
) -> None:
    """End a token, from the next request on."""
    ask(
        lambda camera: camera.tokens.revoke(token_id),
        lambda revoked: f"revoked {revoked.id}",
    )
