"""Tokens, and the callers that they admit. The state directory checks them, and has no secret."""

from __future__ import annotations

import hashlib
import hmac
import math
import re
import secrets
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from veilcam_client.wire.tokens import ROLES, SCOPES, NewToken, Scope, Token, role_of
from veilcam_server.errors import ProblemError, StartError, StorageError, UnauthorizedError
from veilcam_server.system.state_file import Report, StateStore, log_fault, make_directory
from veilcam_server.system.state_folder import unusable

KEPT = 90 * 86_400.0
"""How long a token that was revoked, or has expired, stays on the list [s]."""
_PAUSE = 60.0
"""Before the day of a use is written again, where that failed [s]."""
NO_DIGEST = 64 * "0"
"""Digest of no secret."""
_TOKEN = re.compile(r"(?i:bearer) vc_([0-9a-f]{12})_([0-9a-f]{64})", re.ASCII)


@dataclass(frozen=True, slots=True)
class Caller:
    """Caller of the API.

    Attributes:
        id: id of the token; where none is wanted, the peer's address.
        label: label of the token, for people.
        scopes: scopes of the caller.
        expires: end of the token, seconds since 1970; None: never.
        full_scores: True where the daemon tells scores in full, and not in tenths.
    """

    id: str
    label: str
    scopes: frozenset[str]
    expires: float | None = None
    full_scores: bool = False

    def may(self, scope: Scope) -> bool:
        """Return whether the caller has this scope."""
        return scope in self.scopes

    def require(self, scope: Scope) -> None:
        """Raise :class:`ProblemError` unless the caller has this scope."""
        if not self.may(scope):
            raise ProblemError(
                "forbidden",
                f"this token lacks the scope {scope}: ask for one of the role "
                f"{next(role for role, its in ROLES.items() if scope in its)}",
            )


class _Row(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)
    id: str
    label: str
    scopes: tuple[str, ...]
    created: float
    expires: float | None = None
    revoked: float | None = None
    used: str | None = None
    digest: str

    @property
    def ended(self) -> float:
        """Since when it lets nobody in; inf while it may."""
        return min(time for time in (self.expires, self.revoked, float("inf")) if time is not None)

    @property
    def is_owner(self) -> bool:
        """Return whether it has every scope."""
        return set(self.scopes) >= set(ROLES["owner"])

    def public(self) -> Token:
        return Token(
            id=self.id,
            label=self.label,
            role=role_of(self.scopes),
            scopes=self.scopes,
            created_at=_datetime(self.created),
            expires_at=None if self.expires is None else _datetime(self.expires),
            revoked_at=None if self.revoked is None else _datetime(self.revoked),
            last_used_on=self.used,
        )


class _Tokens(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)
    seen: float = 0.0
    """The latest time at which one was made or revoked."""
    tokens: tuple[_Row, ...] = ()


class TokenStore:
    """``DIRECTORY/tokens.json``; a daemon sees at once what another process changes in it.

    A token is ``vc_ID_SECRET`` with a secret of 256 bits, of which the file has the SHA-256: a
    secret that cannot be guessed needs no slow hash. What is asked at every request comes from
    memory, which is read anew when the file changed. Where neither of its copies is whole there is
    no token, and nobody is let in until one is made.

    Time only goes on: a clock that is set back brings no expired token back while the daemon runs,
    and none that had expired when a token was last made or revoked after a restart.

    A token is forgotten ``KEPT`` after it ended, when the next one is made or revoked.

    Args:
        directory: the daemon's state directory; made if it is not there.
        now: wall clock, seconds since 1970.
        monotonic: a clock that is never set [s].
        report: takes what was damaged.

    Raises:
        StartError: the directory cannot be used.
    """

    def __init__(
        self,
        directory: Path,
        now: Callable[[], float] = time.time,
        monotonic: Callable[[], float] = time.monotonic,
        report: Report = log_fault,
    ) -> None:
        self._wall, self._monotonic = now, monotonic
        try:
            make_directory(directory)
        except OSError as error:
            raise unusable(directory, error) from None
        self._file = StateStore(
            directory / "tokens.json",
            _Tokens,
            lost="nobody is let in until 'veilcamd token first' makes a token",
            report=report,
        )
        self._version = self._file.version
        held = self._file.read() or _Tokens()
        self._known = _by_id(held)
        unknown = {scope for row in held.tokens for scope in row.scopes} - set(SCOPES)
        if unknown:
            raise StartError(
                f"{directory / 'tokens.json'} has tokens of another version, with the scopes "
                f"{' '.join(sorted(unknown))}: move it away and make the tokens again"
            )
        self._seen, self._since = held.seen, monotonic()
        self._note_from = -math.inf

    def create(
        self,
        label: str,
        scopes: tuple[Scope, ...],
        lifetime: float | None = None,
        *,
        first: bool = False,
    ) -> NewToken:
        """Make a token; arguments and errors as :meth:`creating`."""
        with self.creating(label, scopes, lifetime, first=first) as made:
            return made

    @contextmanager
    def creating(
        self,
        label: str,
        scopes: tuple[Scope, ...],
        lifetime: float | None = None,
        *,
        until: float | None = None,
        first: bool = False,
    ) -> Iterator[NewToken]:
        """Yield a token that is valid when the context has ended, unless that raises.

        What a full disk can prevent, it prevents before the context begins. The context is short,
        since no other process changes the tokens meanwhile.

        Args:
            label: label for people.
            scopes: scopes of the token.
            lifetime: lifetime [s], None for ever.
            until: end, seconds since 1970, where no lifetime is given; None: never.
            first: True: only where no valid token has all scopes.

        Raises:
            ProblemError: there is an owner, and it was to be the first.
            StorageError: it cannot be written.
        """
        now, secret = self.now(), secrets.token_hex(32)
        row = _Row(
            id=secrets.token_hex(6),
            label=label,
            scopes=tuple(sorted(set(scopes))),
            created=now,
            expires=until if lifetime is None else now + lifetime,
            digest=secret_digest(secret),
        )

        def add(held: _Tokens) -> _Tokens:
            owners = (each for each in held.tokens if now < each.ended and each.is_owner)
            if first and (owner := next(owners, None)) is not None:
                raise ProblemError(
                    "conflict",
                    f"token {owner.id} ({owner.label}) is an owner's: make more with 'veilcamd "
                    "token create --role owner --label NAME', or revoke it if it is lost",
                )
            return _advanced(held, now, {**_current(held, now), row.id: row})

        with closing(self._file.stage(lambda held: add(held or _Tokens()))) as staged:
            yield NewToken(**row.public().model_dump(), secret=f"vc_{row.id}_{secret}")
            staged.commit()

    def tokens(self) -> tuple[Token, ...]:
        """All tokens, the oldest first; raises :class:`StorageError`."""
        self._refresh()
        return tuple(row.public() for row in self._known.values())

    def revoke(self, token_id: str) -> Token:
        """Let a token do nothing any more; one that was revoked before stays so.

        Raises:
            ProblemError: there is none of this id.
            StorageError: it cannot be written.
        """
        now = self.now()

        def revoke(held: _Tokens) -> _Tokens:
            rows = _current(held, now)
            row = rows.get(token_id)
            if row is None:
                raise ProblemError(
                    "not_found",
                    "there is no token of this id: 'veilcamd token list' names them all",
                )
            if row.revoked is None:
                rows[token_id] = row.model_copy(update={"revoked": now})
            return _advanced(held, now, rows)

        return _by_id(self._change(revoke))[token_id].public()

    def caller(self, authorization: str) -> Caller:
        """Return the caller who sends this ``Authorization`` header.

        Raises:
            UnauthorizedError: no token, or one that is unknown, revoked, expired or misspelt: which
                of these it is, is nobody's business.
            StorageError: the file cannot be read.
        """
        self._refresh()
        match = _TOKEN.fullmatch(authorization)
        token_id, secret = match.groups() if match else ("", "")
        row = self._known.get(token_id)
        right = hmac.compare_digest(secret_digest(secret), row.digest if row else NO_DIGEST)
        return self._admitted(row if right else None)

    def caller_of(self, token_id: str) -> Caller:
        """Return the caller of the token of this id; raises as :meth:`caller`."""
        self._refresh()
        return self._admitted(self._known.get(token_id))

    def _admitted(self, row: _Row | None) -> Caller:
        now = self.now()
        if row is None or row.revoked is not None:
            raise UnauthorizedError
        if row.expires is not None and now >= row.expires:
            raise UnauthorizedError
        self._note_use(row, now)
        return Caller(row.id, row.label, frozenset(row.scopes), row.expires)

    def lifetime(self, caller: Caller) -> float | None:
        """Return the remaining lifetime of the caller's token [s], None for ever."""
        return None if caller.expires is None else max(0.0, caller.expires - self.now())

    def _change(self, update: Callable[[_Tokens], _Tokens]) -> _Tokens:
        return self._file.change(lambda held: update(held or _Tokens()))

    def _refresh(self) -> None:
        version = self._file.version
        if version == self._version:
            return
        self._known, self._version = _by_id(self._file.read() or _Tokens()), version

    def _note_use(self, row: _Row, now: float) -> None:
        today = _datetime(now).strftime("%Y-%m-%d")
        if row.used == today or self._monotonic() < self._note_from:
            return

        def note(held: _Tokens) -> _Tokens:
            rows = _by_id(held)
            if row.id in rows:
                rows[row.id] = rows[row.id].model_copy(update={"used": today})
            return held.model_copy(update={"tokens": tuple(rows.values())})

        # Once a day for each token; that it cannot be written is no reason to refuse a request.
        try:
            self._change(note)
        except StorageError:
            self._note_from = self._monotonic() + _PAUSE

    def now(self) -> float:
        """Return the wall clock, but never less than it was plus the time since then."""
        now = max(self._wall(), self._seen + self._monotonic() - self._since)
        self._seen, self._since = now, self._monotonic()
        return now


def _advanced(held: _Tokens, now: float, rows: Mapping[str, _Row]) -> _Tokens:
    # Not at every use: one second in which the clock stands in 2099 would end tokens for good.
    return _Tokens(seen=max(held.seen, now), tokens=tuple(rows.values()))


def _current(held: _Tokens, now: float) -> dict[str, _Row]:
    """All that are not to be forgotten."""
    return {row.id: row for row in held.tokens if now < row.ended + KEPT}


def _by_id(held: _Tokens) -> dict[str, _Row]:
    return {row.id: row for row in held.tokens}


def secret_digest(secret: str) -> str:
    """Return the SHA-256 of a secret, as files have it."""
    return hashlib.sha256(secret.encode()).hexdigest()


def _datetime(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)
