"""``veilcam token``: the tokens of a daemon, over its API."""

from typing import Annotated

import typer
from pydantic import ValidationError

from veilcam_client.cli.terminal import USAGE, Ask, asking, fail
from veilcam_client.cli.token_words import ROLE_HELP, SCOPE_HELP, token_in_words, unknown_scopes
from veilcam_client.wire.tokens import TOKENS_AT_ONCE, TokenRequest

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
    label: Annotated[str, typer.Option(help="For whom or what it is.")],
    role: Annotated[str | None, typer.Option(help=ROLE_HELP)] = None,
    scope: Annotated[list[str] | None, typer.Option(help=SCOPE_HELP)] = None,
    days: Annotated[
        float | None,
        typer.Option(min=0, max=3660, help="How long it is valid; until it is revoked by default."),
    ] = None,
) -> None:
    """Make a token and print it. It is shown this once."""
    unknown = unknown_scopes(scope or ())
    if unknown is not None:
        fail(unknown, USAGE)
    seconds = None if days is None else round(86_400 * days)
    try:
        asked = TokenRequest.model_validate(
            {"label": label, "role": role, "scopes": tuple(scope or ()), "seconds": seconds}
        )
    except ValidationError as error:
        item = error.errors()[0]
        if not item["loc"]:
            fail("give --role or --scope, one of the two", USAGE)
        option = {"scopes": "scope", "seconds": "days"}.get(str(item["loc"][0]), item["loc"][0])
        fail(f"--{option}: {item['msg']}", USAGE)

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
