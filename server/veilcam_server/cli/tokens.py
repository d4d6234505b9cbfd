"""``veilcamd token``: make, list and revoke tokens, whether a daemon runs or not."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from veilcam_client.cli.token_words import (
    DaysOption,
    LabelOption,
    RoleOption,
    ScopeOption,
    asked_token,
    token_in_words,
)
from veilcam_client.wire.tokens import ROLES, Token, Tokens
from veilcam_server.cli.terminal import USAGE, JsonOption, StateDirOption, changing_state, fail
from veilcam_server.environment import default_state_dir

if TYPE_CHECKING:
    from veilcam_server.security.tokens import TokenStore

Note = Callable[[str, Token], None]
"""Writes an action and its token to the log."""

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Make, list and revoke the tokens of a daemon of this machine, also while it runs. Wants "
    "no token: the state directory says who may. From elsewhere: 'veilcam token'.",
)


@app.command()
def create(
    *,
    label: LabelOption,
    role: RoleOption = None,
    scope: ScopeOption = None,
    days: DaysOption = None,
    state_dir: StateDirOption = None,
    json: JsonOption = False,
) -> None:
    """Make a token of a role or of scopes, and print it. It is shown this once."""
    try:
        asked = asked_token(label, role, scope, days)
    except ValueError as error:
        fail(str(error), USAGE)
    with _store(state_dir) as (store, note):
        made = store.create(asked.label, asked.allowed, asked.seconds)
        note("token create", made)
    typer.echo(made.model_dump_json() if json else made.secret)


@app.command()
def first(*, state_dir: StateDirOption = None, json: JsonOption = False) -> None:
    """Make the first token of an owner and print it, on a terminal alone. It is shown this once."""
    if not sys.stdout.isatty():
        fail(
            "the token would end up in a file or a log: run it in a terminal. A program makes one "
            "with 'veilcamd token create --role owner --label NAME'",
            USAGE,
        )
    directory = state_dir or default_state_dir()
    if not directory.exists():
        fail(f"there is no {directory}: start the daemon first, or give its --state-dir")
    with _store(state_dir) as (store, note):
        made = store.create("first owner", ROLES["owner"], first=True)
        note("token first", made)
    typer.echo(made.model_dump_json() if json else made.secret)


@app.command("list")
def list_tokens(
    *,
    state_dir: StateDirOption = None,
    json: JsonOption = False,
) -> None:
    """Print all tokens without their secrets."""
    with _store(state_dir) as (store, _):
        tokens = store.tokens()
    if json:
        typer.echo(Tokens(tokens=tokens).model_dump_json())
        return
    if not tokens:
        typer.echo("no tokens: make the first with 'veilcamd token first'")
        return
    for token in tokens:
        typer.echo(token_in_words(token))


@app.command()
def revoke(
    token_id: Annotated[
        str, typer.Argument(metavar="ID", help="As 'veilcamd token list' names it")
    ],
    *,
    state_dir: StateDirOption = None,
    json: JsonOption = False,
) -> None:
    """Let a token do nothing any more, from the next request on."""
    with _store(state_dir) as (store, note):
        revoked = store.revoke(token_id)
        note("token revoke", revoked)
    typer.echo(revoked.model_dump_json() if json else f"revoked {token_id}")


@contextmanager
def _store(state_dir: Path | None) -> Iterator[tuple[TokenStore, Note]]:
    from veilcam_server.security.tokens import TokenStore  # noqa: PLC0415 - --help need not wait

    with changing_state(state_dir) as (directory, report, write):
        store = TokenStore(directory, report=report)
        yield (
            store,
            lambda action, token: write(
                {"action": action, "token": token.id, "label": token.label}
            ),
        )
