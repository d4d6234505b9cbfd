"""Options of a new token, and a token in words: for ``veilcam token`` and ``veilcamd token``."""

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Annotated

import typer
from pydantic import ValidationError

from veilcam_client.wire.tokens import ROLES, SCOPES, Token, TokenRequest

ROLE_HELP = f"Role of the token: {', '.join(ROLES)}."
"""Help of the option ``--role``."""
_SCOPE_HELP = f"What it allows; give it several times. One of {', '.join(SCOPES)}."

LabelOption = Annotated[str, typer.Option(help="For whom or what it is.")]
RoleOption = Annotated[str | None, typer.Option(help=ROLE_HELP)]
ScopeOption = Annotated[list[str] | None, typer.Option(help=_SCOPE_HELP)]
DaysOption = Annotated[
    float | None,
    typer.Option(min=0, max=3660, help="How long it is valid; until it is revoked by default."),
]


def asked_token(
    label: str, role: str | None, scopes: Sequence[str] | None, days: float | None
) -> TokenRequest:
    """Return the token that these options ask for; raises ValueError, which names the option."""
    unknown = [scope for scope in dict.fromkeys(scopes or ()) if scope not in SCOPES]
    if unknown:
        typed = " ".join(f"--scope {scope!r}" for scope in unknown)
        raise ValueError(f"{typed}: there is no such scope: use {', '.join(SCOPES)}")
    seconds = None if days is None else round(86_400 * days)
    if seconds == 0:
        raise ValueError("--days: a token is valid for a second at least")
    given = {"label": label, "role": role, "scopes": tuple(scopes or ()), "seconds": seconds}
    try:
        return TokenRequest.model_validate(given)
    except ValidationError as error:
        item = error.errors()[0]
        if not item["loc"]:
            raise ValueError("give --role or --scope, one of the two") from None
        option = str(item["loc"][0]).removesuffix("s")
        raise ValueError(f"--{option}: {item['msg']}") from None


def token_in_words(token: Token) -> str:
    """Return a token in two lines."""
    used = f"used {token.last_used_on}" if token.last_used_on else "never used"
    allowed = token.role or " ".join(token.scopes)
    return f"{token.id}  {_validity(token):<24}  {used:<15}  {token.label}\n{'':14}{allowed}"


def _validity(token: Token) -> str:
    if token.revoked_at is not None:
        return f"revoked {token.revoked_at:%Y-%m-%d}"
    if token.expires_at is None:
        return "until it is revoked"
    word = "expired" if token.expires_at <= datetime.now(UTC) else "until"
    return f"{word} {token.expires_at:%Y-%m-%d %H:%M}"
