"""Sessions of a page: two halves that are nothing alone, and that end with their token."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from starlette.datastructures import Headers
from tests.unit.server.security.conftest import Clock

from veilcam_server.errors import StorageError, UnauthorizedError
from veilcam_server.security.sessions import (
    HEADER,
    LIFETIME,
    MOST_OF_ONE,
    Begun,
    SessionStore,
    cookie_name,
)
from veilcam_server.security.tokens import TokenStore

if TYPE_CHECKING:
    from veilcam_server.errors import ProblemError

HOST = "127.0.0.1:8787"


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def tokens(tmp_path: Path, clock: Clock) -> TokenStore:
    return TokenStore(tmp_path / "state", now=clock, monotonic=clock)


@pytest.fixture
def sessions(tmp_path: Path, tokens: TokenStore) -> SessionStore:
    return SessionStore(tmp_path / "state", tokens)


def begin(sessions: SessionStore, tokens: TokenStore, lifetime: float | None = None) -> Begun:
    made = tokens.create("page", ("read:status",), lifetime)
    return sessions.begin(tokens.caller(f"Bearer {made.secret}"))


def headers(begun: Begun, **others: str) -> Headers:
    cookie = f"other=1; {cookie_name(HOST)}={begun.cookie}"
    return Headers({"host": HOST, "cookie": cookie, HEADER: begun.half, **others})


def is_let_in(sessions: SessionStore, asked: Headers) -> bool:
    try:
        sessions.caller(asked)
    except UnauthorizedError:
        return False
    return True


def test_both_halves_together_are_the_token_and_neither_is_anything_alone(
    sessions: SessionStore, tokens: TokenStore
) -> None:
    begun, other = begin(sessions, tokens), begin(sessions, tokens)
    caller = sessions.caller(headers(begun))
    assert caller.label == "page"
    assert caller.scopes == {"read:status"}
    assert caller.expires is None
    for wrong in (
        Headers({"host": HOST, HEADER: begun.half}),
        headers(Begun(other.cookie, begun.half, 0.0, 0.0)),
        headers(Begun(begun.half, begun.cookie, 0.0, 0.0)),
        headers(begun, host="127.0.0.1:8788"),
        headers(begun, **{HEADER: f"{begun.half} "}),
        headers(begun, **{HEADER: ""}),
    ):
        assert not is_let_in(sessions, wrong)
    twice = Headers(raw=[*headers(begun).raw, (HEADER.lower().encode(), begun.half.encode())])
    assert not is_let_in(sessions, twice)


def test_session_ends_after_a_week_and_with_its_token(
    sessions: SessionStore, tokens: TokenStore, clock: Clock
) -> None:
    long, short = begin(sessions, tokens), begin(sessions, tokens, 60.0)
    assert sessions.expires(headers(long)) == clock.now + LIFETIME
    assert (short.expires, short.lifetime) == (clock.now + 60, 60)
    clock.now += 61
    assert is_let_in(sessions, headers(long))
    assert not is_let_in(sessions, headers(short))
    clock.now += LIFETIME
    assert not is_let_in(sessions, headers(long))
    again = begin(sessions, tokens)
    tokens.revoke(sessions.caller(headers(again)).id)
    assert not is_let_in(sessions, headers(again))


def test_session_outlasts_a_restart_and_the_disk_has_neither_half(
    sessions: SessionStore, tokens: TokenStore, tmp_path: Path
) -> None:
    begun, left = begin(sessions, tokens), begin(sessions, tokens)
    sessions.end(headers(left))
    sessions.end(Headers({"host": HOST}))  # of none: it changes nothing
    restarted = SessionStore(tmp_path / "state", tokens)
    assert is_let_in(restarted, headers(begun))
    assert not is_let_in(restarted, headers(left))
    written = b"".join(path.read_bytes() for path in (tmp_path / "state").iterdir())
    for half in (begun.cookie, begun.half):
        assert half.encode() not in written
    assert begun.cookie not in repr(begun)
    assert begun.half not in repr(begun)


def test_one_token_has_so_many_and_the_oldest_ends_first(
    sessions: SessionStore, tokens: TokenStore
) -> None:
    made = tokens.create("page", ("read:status",), None)
    caller, other = tokens.caller(f"Bearer {made.secret}"), begin(sessions, tokens)
    begun = [sessions.begin(caller) for _ in range(MOST_OF_ONE + 2)]
    assert [is_let_in(sessions, headers(each)) for each in begun[:3]] == [False, False, True]
    assert is_let_in(sessions, headers(begun[-1]))
    assert is_let_in(sessions, headers(other))


def test_full_disk_keeps_nobody_out_and_is_told_of_where_a_session_should_end(
    sessions: SessionStore, tokens: TokenStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise StorageError("No space left on device")

    monkeypatch.setattr(sessions._file, "change", refuse)
    begun = begin(sessions, tokens)
    assert is_let_in(sessions, headers(begun))
    with pytest.raises(StorageError, match="No space left"):
        sessions.end(headers(begun))
    assert not is_let_in(sessions, headers(begun))


def test_damaged_sessions_are_told_of_and_everybody_logs_in_again(
    sessions: SessionStore, tokens: TokenStore, tmp_path: Path
) -> None:
    begun = begin(sessions, tokens)
    for name in ("sessions.json", "sessions.json.copy"):
        (tmp_path / "state" / name).write_text("{")
    told: list[ProblemError] = []
    restarted = SessionStore(tmp_path / "state", tokens, told.append)
    assert not is_let_in(restarted, headers(begun))
    assert "gives the token again" in str(told[0])


def test_daemons_on_one_host_have_cookies_of_their_own() -> None:
    ends = {"a": "", "a:1": "-1", "a:2": "-2", "[::1]": "", "[::1]:443": "-443"}
    assert {host: cookie_name(host) for host in ends} == {
        host: f"veilcam-session{end}" for host, end in ends.items()
    }
