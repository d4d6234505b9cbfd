"""Tokens with their scopes, and sessions of a page."""

from __future__ import annotations

from datetime import datetime
from typing import Literal, get_args

from pydantic import Field

from veilcam_client.wire.base import EXAMPLE_TIME, Answer, Examples, Question

Scope = Literal[
    "read:status",
    "classify",
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
    """For whom or what it is; it stands in the log."""
    scopes: tuple[Scope, ...] = Field(min_length=1, max_length=len(SCOPES), strict=False)
    """Scopes of the token."""
    seconds: int | None = Field(default=None, ge=1, le=10 * 366 * 86_400)
    """Time that it is valid [s]; None: until it is revoked."""


class Token(Answer):
    """Token as the daemon knows it, without its secret."""

    id: str
    """Name of the token, 12 hexadecimal digits."""
    label: str
    """For whom or what it is."""
    scopes: tuple[str, ...]
    """Scopes of the token."""
    created_at: datetime
    """Time of its creation."""
    expires_at: datetime | None
    """End of its validity; None: until it is revoked."""
    revoked_at: datetime | None
    """Time of its revocation; None: it was not."""
    last_used_on: str | None
    """Day of the last request with it, as YYYY-MM-DD in UTC."""


class NewToken(Token):
    """A token just made; ``secret`` is shown this once."""

    secret: str = Field(repr=False)
    """The token itself, as it is sent."""


class Tokens(Answer):
    """Tokens, the oldest first, revoked and expired ones included."""

    tokens: tuple[Token, ...]
    """Tokens, the oldest first."""
    next: str | None = None
    """``after`` of the request for those that follow; None: there are no more."""


class Session(Answer):
    """Caller and its scopes."""

    tokens: bool
    """True: this daemon wants tokens; else there is nothing to log in to."""
    label: str
    """Label of the token."""
    scopes: tuple[str, ...]
    """Scopes of the caller."""
    expires_at: datetime | None
    """End of the session, or else of the token; None: never."""


class NewSession(Session):
    """A session just begun. Its other half is a cookie that no script can read."""

    half: str = Field(repr=False, pattern=r"^[0-9a-f]{64}$")
    """The page sends it as ``Veilcam-Session`` with every request; shown this once."""


def _token() -> Token:
    return Token(
        id="0123456789ab",
        label="lamp",
        scopes=("classify", "read:status"),
        created_at=EXAMPLE_TIME,
        expires_at=None,
        revoked_at=None,
        last_used_on="2026-01-02",
    )


def _session() -> Session:
    return Session(
        tokens=True, label="kitchen", scopes=("classify", "read:status"), expires_at=EXAMPLE_TIME
    )


EXAMPLES = Examples(
    lambda: (
        TokenRequest(label="lamp", scopes=("classify", "read:status"), seconds=86_400),
        _token(),
        NewToken(**_token().model_dump(), secret="vc_0123456789ab_" + "0f" * 32),
        Tokens(tokens=(_token(),), next="0123456789ab"),
        _session(),
        NewSession(**_session().model_dump(), half="0f" * 32),
    )
)
