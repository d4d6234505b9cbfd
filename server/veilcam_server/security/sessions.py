"""Sessions of the page in a browser: a token once, then two halves that are nothing alone.

One half is a cookie that no script can read. Browsers send it by themselves, also with what another
page makes them ask, and to every port of this host. So it opens nothing without the other half,
which the daemon's own page keeps and sends in a header.
"""

from __future__ import annotations

import hashlib
import re
import secrets
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import structlog
from pydantic import BaseModel, ConfigDict
from starlette.datastructures import Headers
from starlette.requests import cookie_parser

from veilcam_server.errors import StorageError, UnauthorizedError
from veilcam_server.security.tokens import Caller, TokenStore
from veilcam_server.system.state_file import Report, StateStore, log_fault

LIFETIME = 7 * 86_400.0
"""Of a session, unless its token ends before [s]."""
MOST_OF_ONE = 16
"""Sessions that one token may have; one more ends the oldest."""
HEADER = "Veilcam-Session"
"""Of the page's half."""
_HALF = re.compile(r"[0-9a-f]{64}", re.ASCII)

log = structlog.get_logger()


class _Row(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)
    digest: str
    """SHA-256 of both halves."""
    token: str
    expires: float


class _Sessions(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)
    sessions: tuple[_Row, ...] = ()


@dataclass(frozen=True, slots=True)
class Begun:
    """A session just begun.

    Attributes:
        cookie: the browser's half.
        half: the page's half.
        expires: end of the session, seconds since 1970.
        lifetime: lifetime from now on [s].
    """

    cookie: str = field(repr=False)
    half: str = field(repr=False)
    expires: float
    lifetime: float


def cookie_name(host: str) -> str:
    """Name of the cookie of the daemon at ``host``: browsers tell no ports apart."""
    port = re.search(r":(\d+)$", host)
    return "veilcam-session" + (f"-{port[1]}" if port else "")


class SessionStore:
    """``DIRECTORY/sessions.json``, so that a page goes on after a restart of the daemon.

    The file has the SHA-256 of both halves together, and neither of them. A session allows what its
    token allows, and ends with it. Where the disk takes nothing, a session lasts until the daemon
    ends: who looks why must not be kept out.

    Args:
        directory: the daemon's state directory.
        tokens: tokens to which sessions belong, and by whose clock they end.
        report: takes what was damaged.

    Raises:
        StartError: the record cannot be read.
    """

    def __init__(self, directory: Path, tokens: TokenStore, report: Report = log_fault) -> None:
        self._tokens = tokens
        self._file = StateStore(
            directory / "sessions.json",
            _Sessions,
            lost="whoever was logged in on the page gives the token again",
            report=report,
        )
        self._lock = threading.Lock()
        held = self._file.read() or _Sessions()
        self._rows: Mapping[str, _Row] = {row.digest: row for row in held.sessions}

    def begin(self, caller: Caller) -> Begun:
        """Begin a session with what the caller's token allows."""
        cookie, half = secrets.token_hex(32), secrets.token_hex(32)
        now = self._tokens.now()
        expires = min(now + LIFETIME, float("inf") if caller.expires is None else caller.expires)
        row = _Row(digest=_digest(cookie, half), token=caller.id, expires=expires)

        def add(rows: Mapping[str, _Row]) -> dict[str, _Row]:
            own = [digest for digest, each in rows.items() if each.token == caller.id]
            ended = set(own[: max(0, len(own) + 1 - MOST_OF_ONE)])
            kept = {digest: each for digest, each in rows.items() if digest not in ended}
            return {**kept, row.digest: row}

        try:
            self._change(add)
        except StorageError as error:
            log.warning("a session will not outlast the daemon", reason=str(error))
        return Begun(cookie, half, expires, expires - now)

    def caller(self, headers: Headers) -> Caller:
        """Return the caller who sends both halves of a session.

        Raises:
            UnauthorizedError: one is missing, or the session or its token has ended.
            StorageError: the tokens cannot be read.
        """
        row = self._row(headers)
        if row is None or self._tokens.now() >= row.expires:
            raise UnauthorizedError
        return self._tokens.caller_of(row.token)

    def expires(self, headers: Headers) -> float | None:
        """Return the end of a request's session, seconds since 1970; None: it is of none."""
        row = self._row(headers)
        return None if row is None else row.expires

    def end(self, headers: Headers) -> None:
        """End the session of a request, at once.

        Raises:
            StorageError: the disk refuses: after a restart it would go on until it expires.
        """
        row = self._row(headers)
        if row is not None:
            self._change(
                lambda rows: {key: each for key, each in rows.items() if key != row.digest}
            )

    def _row(self, headers: Headers) -> _Row | None:
        halves = headers.getlist(HEADER)
        cookies = cookie_parser("; ".join(headers.getlist("cookie")))
        cookie = cookies.get(cookie_name(headers.get("host", "").lower()), "")
        if len(halves) != 1 or not (_HALF.fullmatch(cookie) and _HALF.fullmatch(halves[0])):
            return None
        # Looked up by a hash of 512 random bits: how long that takes tells nothing of them.
        return self._rows.get(_digest(cookie, halves[0]))

    def _change(self, update: Callable[[Mapping[str, _Row]], dict[str, _Row]]) -> None:
        with self._lock:
            now = self._tokens.now()
            current = {key: row for key, row in self._rows.items() if now < row.expires}
            self._rows = update(current)
            held = _Sessions(sessions=tuple(self._rows.values()))
            self._file.change(lambda _: held)


def _digest(cookie: str, half: str) -> str:
    return hashlib.sha256(f"{cookie}.{half}".encode()).hexdigest()
