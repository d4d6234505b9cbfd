"""Tokens: who may ask this daemon. The state directory holds what checks them, never a secret."""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from veilcam_client.wire.tokens import SCOPES, NewToken, Scope, Token
from veilcam_server.errors import StartError, TokenStoreError, UnauthorizedError, UnknownTokenError
from veilcam_server.security.caller import Caller

_TOKEN = re.compile(r"Bearer vc_([0-9a-f]{12})_([0-9a-f]{64})", re.ASCII)
_COLUMNS = "id, label, scopes, created, expires, revoked, used, digest"
_SCHEMA = """
CREATE TABLE IF NOT EXISTS token (
    id TEXT PRIMARY KEY, label TEXT NOT NULL, scopes TEXT NOT NULL, created REAL NOT NULL,
    expires REAL, revoked REAL, used TEXT, digest BLOB NOT NULL) STRICT;
CREATE TABLE IF NOT EXISTS clock (
    one INTEGER PRIMARY KEY CHECK (one = 1), seen REAL NOT NULL) STRICT;
INSERT OR IGNORE INTO clock VALUES (1, 0);
"""


@dataclass(frozen=True, slots=True)
class _Row:
    id: str
    label: str
    scopes: str
    created: float
    expires: float | None
    revoked: float | None
    used: str | None
    digest: bytes

    def public(self) -> Token:
        return Token(
            id=self.id,
            label=self.label,
            scopes=tuple(self.scopes.split()),
            created_at=_datetime(self.created),
            expires_at=None if self.expires is None else _datetime(self.expires),
            revoked_at=None if self.revoked is None else _datetime(self.revoked),
            last_used_on=self.used,
        )


class TokenStore:
    """``DIRECTORY/tokens.sqlite3``; a daemon sees at once what another process changes in it.

    A token is ``vc_ID_SECRET`` with a secret of 256 bits, of which the file has the SHA-256: a
    secret that cannot be guessed needs no slow hash. What is asked at every request comes from
    memory, which is read anew when the file changed.

    Time only goes on: a clock that is set back brings no expired token back while the daemon runs,
    and none that had expired when a token was last made or revoked after a restart.

    Args:
        directory: the daemon's state directory; made if it is not there.
        now: wall clock, seconds since 1970.
        monotonic: a clock that is never set [s].

    Raises:
        StartError: the file cannot be used.
    """

    def __init__(
        self,
        directory: Path,
        now: Callable[[], float] = time.time,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self.patience = 5.0
        """How long another process may keep the file to itself [s]."""
        self._path, self._wall, self._monotonic = directory / "tokens.sqlite3", now, monotonic
        self._known: dict[str, _Row] = {}
        self._version = -1
        try:
            directory.mkdir(parents=True, exist_ok=True, mode=0o700)
            # Before SQLite opens it: its own files beside it take over the permissions.
            os.close(os.open(self._path, os.O_RDWR | os.O_CREAT, 0o600))
            self._path.chmod(0o600)
            self._reader = self._connect()
            self._reader.executescript(_SCHEMA)
            self._seen = float(self._reader.execute("SELECT seen FROM clock").fetchone()[0])
            held = self._reader.execute("SELECT scopes FROM token").fetchall()
        except (sqlite3.Error, OSError) as error:
            raise StartError(
                f"{self._path} cannot be used ({error}): check it, or give another --state-dir"
            ) from None
        unknown = {scope for row in held for scope in row[0].split()} - set(SCOPES)
        if unknown:
            raise StartError(
                f"{self._path} has tokens of an earlier version, with the scopes "
                f"{' '.join(sorted(unknown))}: move it away and make the tokens again"
            )
        self._since = monotonic()

    def create(self, label: str, scopes: tuple[Scope, ...], lifetime: float | None) -> NewToken:
        """Make a token.

        Args:
            label: for whom or what it is.
            scopes: what it allows.
            lifetime: how long it is valid [s], None for ever.

        Raises:
            TokenStoreError: it cannot be written.
        """
        now, secret = self._now(), secrets.token_hex(32)
        expires = None if lifetime is None else now + lifetime
        held = " ".join(sorted(set(scopes)))
        row = _Row(secrets.token_hex(6), label, held, now, expires, None, None, _digest(secret))
        with self._writing() as database:
            _advance(database, now)
            database.execute(
                f"INSERT INTO token ({_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)",  # noqa: S608
                (row.id, label, held, now, expires, None, None, row.digest),
            )
        return NewToken(**row.public().model_dump(), secret=f"vc_{row.id}_{secret}")

    def tokens(self) -> tuple[Token, ...]:
        """All tokens, the oldest first; raises :class:`TokenStoreError`."""
        self._refresh()
        return tuple(row.public() for row in self._known.values())

    def revoke(self, token_id: str) -> Token:
        """Let a token do nothing any more; one that was revoked before stays so.

        Raises:
            UnknownTokenError: there is none of this id.
            TokenStoreError: it cannot be written.
        """
        now = self._now()
        with self._writing() as database:
            _advance(database, now)
            found = database.execute(
                "UPDATE token SET revoked = coalesce(revoked, ?) WHERE id = ? RETURNING id",
                (now, token_id),
            ).fetchall()
        if not found:
            raise UnknownTokenError(
                "there is no token of this id: 'veilcamd token list' names them all"
            )
        self._refresh()
        return self._known[token_id].public()

    def caller(self, authorization: str) -> Caller:
        """Who sends this ``Authorization`` header.

        Raises:
            UnauthorizedError: no token, or one that is unknown, revoked, expired or misspelt: which
                of these it is, is nobody's business.
            TokenStoreError: the file cannot be read.
        """
        self._refresh()
        match = _TOKEN.fullmatch(authorization)
        token_id, secret = match.groups() if match else ("", "")
        row = self._known.get(token_id)
        now = self._now()
        right = hmac.compare_digest(_digest(secret), row.digest if row else bytes(32))
        if row is None or not right or row.revoked is not None:
            raise UnauthorizedError
        if row.expires is not None and now >= row.expires:
            raise UnauthorizedError
        self._note_use(row, now)
        return Caller(row.id, row.label, frozenset(row.scopes.split()), row.expires)

    def lifetime(self, caller: Caller) -> float | None:
        """How long the caller's token is still valid [s], None for ever."""
        return None if caller.expires is None else max(0.0, caller.expires - self._now())

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def _connect(self) -> sqlite3.Connection:
        database = sqlite3.connect(
            self._path, timeout=self.patience, isolation_level=None, check_same_thread=False
        )
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA synchronous = FULL")
        return database

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        # A connection of its own: it may come from any thread, and the reader sees a change.
        try:
            with closing(self._connect()) as database:
                database.execute("BEGIN IMMEDIATE")
                yield database
                database.execute("COMMIT")
        except sqlite3.Error as error:
            raise TokenStoreError(
                f"the tokens cannot be written ({error}): check the state directory's disk"
            ) from None

    def _refresh(self) -> None:
        try:
            version = self._reader.execute("PRAGMA data_version").fetchone()[0]
            if version == self._version:
                return
            rows = self._reader.execute(
                f"SELECT {_COLUMNS} FROM token ORDER BY rowid"  # noqa: S608
            ).fetchall()
        except sqlite3.Error as error:
            raise TokenStoreError(
                f"the tokens cannot be read ({error}): check the state directory's disk"
            ) from None
        self._known = {row[0]: _Row(*row) for row in rows}
        self._version = version

    def _note_use(self, row: _Row, now: float) -> None:
        today = _datetime(now).strftime("%Y-%m-%d")
        if row.used == today:
            return
        # Once a day for each token; that it cannot be written is no reason to refuse a request.
        with suppress(TokenStoreError), self._writing() as database:
            database.execute("UPDATE token SET used = ? WHERE id = ?", (today, row.id))
        self._known[row.id] = replace(row, used=today)

    def _now(self) -> float:
        """The wall clock, but never less than it was plus the time since then."""
        now = max(self._wall(), self._seen + self._monotonic() - self._since)
        self._seen, self._since = now, self._monotonic()
        return now


def _advance(database: sqlite3.Connection, now: float) -> None:
    # Not at every use: one second in which the clock stands in 2099 would end tokens for good.
    database.execute("UPDATE clock SET seen = max(seen, ?)", (now,))


def _digest(secret: str) -> bytes:
    return hashlib.sha256(secret.encode()).digest()


def _datetime(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)
