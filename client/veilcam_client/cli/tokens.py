"""``veilcam token``: the tokens of a daemon, over its API."""

from __future__ import annotations

from typing import Annotated

import typer
from pydantic import ValidationError

from veilcam_client.camera import DEFAULT_URL, Camera
from veilcam_client.cli.format import token_in_words
from veilcam_client.cli.terminal import (
    USAGE,
    JsonOption,
    TimeoutOption,
    UrlOption,
    ask,
    errors,
    fail,
    print_json,
)
from veilcam_client.wire.tokens import SCOPES, NewToken, TokenRequest

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Make, list and revoke tokens, with one that has the scope admin:tokens.",
)


@app.command()
def create(
    *,
    label: Annotated[str, typer.Option(help="For whom or what it is.")],
    scope: Annotated[
        list[str],
        typer.Option(help=f"What it allows; give it several times. One of {', '.join(SCOPES)}."),
    ],
    days: Annotated[
        float | None,
        typer.Option(min=0, max=3660, help="How long it is valid; until it is revoked by default."),
    ] = None,
    url: UrlOption = DEFAULT_URL,
    timeout: TimeoutOption = 30.0,
    json: JsonOption = False,
) -> None:
    """Make a token and print it. It is shown this once."""
    seconds = None if days is None else round(86_400 * days)
    try:
        asked = TokenRequest.model_validate(
            {"label": label, "scopes": tuple(scope), "seconds": seconds}
        )
    except ValidationError as error:
        item = error.errors()[0]
        option = {"scopes": "scope", "seconds": "days"}.get(str(item["loc"][0]), item["loc"][0])
        fail(f"--{option}: {item['msg']}", USAGE)

    def question(camera: Camera) -> NewToken:
        return camera.create_token(asked.label, asked.scopes, seconds=asked.seconds)

    answer = ask(url, timeout, question)
    if json:
        print_json(answer)
    else:
        typer.echo(answer.secret)


@app.command("list")
def list_tokens(
    *, url: UrlOption = DEFAULT_URL, timeout: TimeoutOption = 30.0, json: JsonOption = False
) -> None:
    """Print all tokens without their secrets."""
    with errors(), Camera(url, read_timeout=timeout) as camera:
        tokens = camera.tokens()
    for token in tokens:
        if json:
            print_json(token)
        else:
            typer.echo(token_in_words(token))


@app.command()
def revoke(
    token_id: Annotated[
        str, typer.Argument(metavar="ID", help="As 'veilcam token list' names it.")
    ],
    *,
    url: UrlOption = DEFAULT_URL,
    timeout: TimeoutOption = 30.0,
    json: JsonOption = False,
) -> None:
    """Let a token do nothing any more, from the next request on."""
    answer = ask(url, timeout, lambda camera: camera.revoke_token(token_id))
    if json:
        print_json(answer)
    else:
        typer.echo(f"revoked {answer.id}")
