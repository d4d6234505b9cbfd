"""Who may do what: scopes, and the tokens that carry them."""

from __future__ import annotations

from datetime import datetime
from typing import Literal, get_args

from pydantic import Field

from veilcam_client.wire.base import EXAMPLE_TIME, Answer, Question

Scope = Literal[
    "read:status",
    "classify",
    "read:scores:rounded",
    "read:scores",
    "read:embedding",
    "read:embedding:raw",
    "read:log",
    "mask:rotate",
    "calibrate",
    "simulate",
    "admin:bundles",
    "admin:receivers",
    "admin:tokens",
    "metrics",
]
"""One thing that a token allows. None contains another."""
SCOPES: tuple[Scope, ...] = get_args(Scope)
TOKENS_AT_ONCE = 100
"""In one answer, unless another number is asked for."""
MOST_TOKENS = 1000
"""That one answer may have."""


class TokenRequest(Question):
    """A token to be made."""

    label: str = Field(min_length=1, max_length=64, pattern=r"^[\x20-\x7e]+$")
    """For whom or what it is; it stands in the audit log."""
    scopes: tuple[Scope, ...] = Field(min_length=1, max_length=len(SCOPES), strict=False)
    seconds: int | None = Field(default=None, ge=1, le=10 * 366 * 86_400)
    """How long it is valid [s]; None: until it is revoked."""


class Token(Answer):
    """What the daemon knows of a token; its secret is not among it."""

    id: str
    label: str
    scopes: tuple[str, ...]
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None
    last_used_on: str | None
    """Day of the last request with it, as YYYY-MM-DD in UTC."""


class NewToken(Token):
    """A token just made; ``secret`` is shown this once."""

    secret: str = Field(repr=False)


class Tokens(Answer):
    """Tokens, the oldest first, revoked and expired ones included."""

    tokens: tuple[Token, ...]
    next: str | None = None
    """``after`` of the request for those that follow; None: there are no more."""


_TOKEN = Token(
    id="0123456789ab",
    label="lamp",
    scopes=("classify", "read:status"),
    created_at=EXAMPLE_TIME,
    expires_at=None,
    revoked_at=None,
    last_used_on="2026-01-02",
)
EXAMPLES = (
    TokenRequest(label="lamp", scopes=("classify", "read:status"), seconds=86_400),
    _TOKEN,
    NewToken(**_TOKEN.model_dump(), secret="vc_0123456789ab_" + "0f" * 32),
    Tokens(tokens=(_TOKEN,), next="0123456789ab"),
)
