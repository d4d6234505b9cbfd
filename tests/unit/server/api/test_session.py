"""Sessions over HTTP: a token once, then a cookie and a header, and what forged requests reach."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import httpx
import pytest
from tests.unit.server.logs import events, open_log

from veilcam_client.wire.tokens import SCOPES, NewSession, Scope, Session
from veilcam_server.security.admission import Admission
from veilcam_server.security.sessions import HEADER, LIFETIME, SessionStore
from veilcam_server.security.tokens import TokenStore

if TYPE_CHECKING:
    from tests.unit.server.conftest import Running

pytestmark = pytest.mark.anyio


@pytest.fixture
def admission(tmp_path: Path, store: TokenStore) -> Iterator[Admission]:
    log = open_log(tmp_path)
    sessions = SessionStore(tmp_path / "tokens", store)
    yield Admission(store, log=log, sessions=sessions)
    log.close()


def bearer(admission: Admission, *scopes: Scope, lasts: float | None = None) -> dict[str, str]:
    assert admission.tokens is not None
    made = admission.tokens.create("kitchen", scopes or SCOPES, lasts)
    return {"Authorization": f"Bearer {made.secret}"}


async def log_in(client: httpx.AsyncClient, token: dict[str, str]) -> NewSession:
    """Take the cookie as a browser does, and return what the page is told."""
    answer = await client.post("/v1/session", headers=token)
    assert answer.status_code == 201
    return NewSession.model_validate_json(answer.content)


async def test_page_asks_with_both_halves_and_may_do_what_its_token_may(
    running: Running, admission: Admission, tmp_path: Path
) -> None:
    async with running(admission=admission) as client:
        begun = await log_in(client, bearer(admission, "read:status"))
        assert (begun.tokens, begun.label, begun.scopes) == (True, "kitchen", ("read:status",))
        page = {HEADER: begun.half}
        told = Session.model_validate_json((await client.get("/v1/session", headers=page)).content)
        assert told.model_dump() == begun.model_dump(exclude={"half"})
        assert (await client.get("/v1/status", headers=page)).status_code == 200
        refused = await client.post("/v1/rotation/advance", headers=page)
        assert refused.json()["code"] == "forbidden"
        # What is wrong with a header is wrong, whatever the cookie is.
        nonsense = {**page, "Authorization": "Bearer nonsense"}
        assert (await client.get("/v1/status", headers=nonsense)).status_code == 401
    (entry,) = [
        each for each in events(tmp_path, "request") if each["action"] == "POST /v1/session"
    ]
    assert entry["label"] == "kitchen"


async def test_cookie_is_for_no_script_and_for_no_other_site(
    running: Running, admission: Admission
) -> None:
    token = bearer(admission, "read:status", lasts=100.0)
    async with running(admission=admission) as client:
        for origin, secure in (("http://localhost", False), ("https://localhost", True)):
            headers = {**token, "Origin": origin}
            answer = await client.post("/v1/session", headers=headers)
            (cookie,) = answer.headers.get_list("set-cookie")
            name, *attributes = cookie.split("; ")
            assert name.startswith("veilcam-session=")
            kept = {each.lower().partition("=")[0]: each.partition("=")[2] for each in attributes}
            # Without a path it is for the folder of the request, whatever a proxy cuts off.
            assert set(kept) == {"httponly", "max-age", "samesite"} | (
                {"secure"} if secure else set()
            )
            assert kept["samesite"].lower() == "strict"
            assert 90 <= int(kept["max-age"]) <= 100 < LIFETIME
            assert answer.json()["half"] not in cookie


async def test_cookie_alone_is_nobody(running: Running, admission: Admission) -> None:
    """What another page, or another port of this host, makes a browser send."""
    async with running(admission=admission) as client:
        begun = await log_in(client, bearer(admission))
        for half in (None, "", "0" * 64, begun.half[:-1]):
            headers = {} if half is None else {HEADER: half}
            for method, path in (
                ("GET", "/v1/status"),
                ("GET", "/v1/session"),
                ("POST", "/v1/session"),
                ("POST", "/v1/rotation/advance"),
                ("DELETE", "/v1/session"),
                ("GET", "/v1/events"),
            ):
                answer = await client.request(method, path, headers=headers)
                assert answer.status_code == 401, (method, path, half)
        page = {HEADER: begun.half}
        assert (await client.get("/v1/status", headers=page)).status_code == 200
        foreign = {**page, "Origin": "http://localhost:3000"}
        assert (await client.post("/v1/rotation/advance", headers=foreign)).status_code == 403
        # Nor does the page's half open anything where the cookie is missing.
        client.cookies.clear()
        assert (await client.get("/v1/status", headers=page)).status_code == 401


async def test_session_makes_no_session_and_ends_when_it_is_told_to(
    running: Running, admission: Admission
) -> None:
    async with running(admission=admission) as client:
        begun = await log_in(client, bearer(admission))
        page = {HEADER: begun.half}
        assert (await client.post("/v1/session", headers=page)).status_code == 401
        cookies = dict(client.cookies)
        answer = await client.delete("/v1/session", headers=page)
        assert answer.status_code == 204
        assert "Max-Age=0" in answer.headers["set-cookie"]
        stolen = {**page, "Cookie": "; ".join(f"{name}={cookies[name]}" for name in cookies)}
        assert (await client.get("/v1/status", headers=stolen)).status_code == 401


async def test_page_makes_tokens_that_outlast_its_session(
    running: Running, admission: Admission
) -> None:
    async with running(admission=admission) as client:
        begun = await log_in(client, bearer(admission))
        answer = await client.post(
            "/v1/tokens",
            headers={HEADER: begun.half},
            json={"label": "lamp", "scopes": ["classify"]},
        )
        assert answer.status_code == 201
        assert answer.json()["expires_at"] is None


async def test_session_is_refused_where_no_tokens_are_wanted(running: Running) -> None:
    async with running() as client:
        told = Session.model_validate_json((await client.get("/v1/session")).content)
        assert (told.tokens, set(told.scopes), told.expires_at) == (False, set(SCOPES), None)
        for method in ("POST", "DELETE"):
            answer = await client.request(method, "/v1/session")
            assert answer.json()["code"] == "not_enabled"
