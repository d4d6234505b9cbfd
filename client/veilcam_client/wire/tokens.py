"""Tokens with their scopes, and sessions of a page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import datetime
from typing import Literal, Self, get_args

from pydantic import Field, model_validator

from veilcam_client.wire.base import EXAMPLE_TIME, Answer, Question

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
Role = Literal["viewer", "operator", "owner"]
"""Role of a person: a name for a set of scopes. Each contains the one before it."""
_VIEWER: tuple[Scope, ...] = ("read:status", "classify")
_OPERATOR: tuple[Scope, ...] = (*_VIEWER, "mask:rotate", "read:embedding")
ROLES: Mapping[Role, tuple[Scope, ...]] = {
    "viewer": _VIEWER,
    "operator": _OPERATOR,
    "owner": SCOPES,
}
"""Scopes of each role. A viewer sees status, labels and the page, and may ask for a label. An
operator also rotates masks, sets the watch and takes captures for receivers that are paired. An
owner may do everything."""
TOKENS_AT_ONCE = 100
"""In one answer, unless another number is asked for."""
MOST_TOKENS = 1000
"""That one answer may have."""


def role_of(scopes: Iterable[str]) -> Role | None:
    """Return the role that has exactly these scopes; None where there is none."""
    given = frozenset(scopes)
    return next((role for role, its in ROLES.items() if given == frozenset(its)), None)


class TokenRequest(Question):
    """A token to be made: of a role, or of scopes."""

    label: str = Field(min_length=1, max_length=64, pattern=r"^[\x20-\x7e]+$")
    """For whom or what it is; it stands in the log."""
    role: Role | None = None
    """Role of the token; None where ``scopes`` are given."""
    scopes: tuple[Scope, ...] = Field(default=(), max_length=len(SCOPES), strict=False)
    """Scopes of the token; empty where a ``role`` is given."""
    seconds: int | None = Field(default=None, ge=1, le=10 * 366 * 86_400)
    """Time that it is valid [s]; None: until it is revoked."""

    @model_validator(mode="after")
    def _role_or_scopes(self) -> Self:
        if (self.role is None) == (not self.scopes):
            raise ValueError("give a role or scopes, one of the two")
        return self

    @property
    def allowed(self) -> tuple[Scope, ...]:
        """Scopes of the token, whichever way they are given."""
        return self.scopes if self.role is None else ROLES[self.role]


class Token(Answer):
    """Token as the daemon knows it, without its secret."""

    id: str
    """Name of the token, 12 hexadecimal digits."""
    label: str
    """For whom or what it is."""
    role: str | None = None
    """Role that has exactly these scopes; None: no role has."""
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
        role="viewer",
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


def examples() -> tuple[Answer | Question, ...]:
    """Return examples for documents."""
    return (
        TokenRequest(label="lamp", role="viewer", seconds=86_400),
        _token(),
        NewToken(**_token().model_dump(), secret="vc_0123456789ab_" + "0f" * 32),
        Tokens(tokens=(_token(),), next="0123456789ab"),
        _session(),
        NewSession(**_session().model_dump(), half="0f" * 32),
    )
