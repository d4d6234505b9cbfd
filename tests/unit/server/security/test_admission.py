"""Who gets in, for what, and how often."""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest
from starlette.datastructures import Headers
from tests.unit.server.security.conftest import bearer
from tests.unit.server.service.waiting import until

from veilcam_client.wire.base import PROBLEM_MEDIA_TYPE
from veilcam_client.wire.tokens import SCOPES, Scope
from veilcam_server.api.app import create_app
from veilcam_server.api.routes import events
from veilcam_server.errors import (
    ProblemError,
)
from veilcam_server.security.admission import Admission, open_admission
from veilcam_server.security.limits import ConcurrencyLimit, RateLimit
from veilcam_server.security.tokens import TokenStore
from veilcam_server.settings import Settings

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench, Running

    from veilcam_client.wire.events import Event
    from veilcam_server.security.tokens import Caller

pytestmark = pytest.mark.anyio

OPEN_PATHS = ("/", "/docs", "/page/{name}", "/healthz", "/readyz", "/v1/pairing/claim")
"""What everybody may ask; all else wants a token."""


def filled(path: str) -> str:
    """A path with something in the place of its parameters."""
    return "/".join("000000000000" if "{" in part else part for part in path.split("/"))


def scopes_of(operation: dict[str, Any]) -> list[str]:
    return [scope for each in operation.get("security", []) for scope in each.get("token", [])]


def body_of(operation: dict[str, Any]) -> dict[str, str]:
    """The media type that a route takes."""
    taken = operation.get("requestBody", {}).get("content", ["application/json"])
    return {"Content-Type": next(iter(taken))}


@pytest.mark.slow
async def test_every_route_wants_a_scope_and_lets_nobody_in_without(
    running: Running, store: TokenStore, bench: Bench
) -> None:
    tokens = {scope: bearer(store, scope) for scope in SCOPES}
    async with running(admission=Admission(tokens=store)) as client:
        document = await client.get("/v1/openapi.json", headers=tokens["read:status"])
        paths = document.json()["paths"]
        assert len(paths) > 5
        for path, operations in paths.items():
            for method, operation in operations.items():
                wanted = scopes_of(operation)
                asked = body_of(operation)
                if path in OPEN_PATHS:
                    assert not wanted
                    continue
                assert wanted, f"{method} {path} wants no scope"
                assert set(wanted) <= set(SCOPES)
                answer = await client.request(method, filled(path))
                assert answer.status_code == 401, (method, path)
                for scope in set(tokens) - set(wanted):
                    headers = {**tokens[scope], **asked}
                    answer = await client.request(
                        method, filled(path), headers=headers, content="{}"
                    )
                    assert answer.status_code == 403, (method, path, scope)
                    assert answer.json()["code"] == "forbidden"
                    assert f"the scope {wanted[0]}:" in answer.json()["detail"]
    assert bench.sensor.captures == 0


async def test_every_route_is_in_the_openapi_document(bench: Bench) -> None:
    def walk(routes: Any) -> Iterator[tuple[str, str]]:
        for route in routes:
            inner = getattr(route, "original_router", None)
            if inner is not None:
                yield from walk(inner.routes)
            else:
                for method in route.methods - {"HEAD", "OPTIONS"}:
                    yield method.lower(), route.path

    app = create_app(bench.service(bench.camera()))
    known = {
        (method, path) for path, methods in app.openapi()["paths"].items() for method in methods
    }
    assert set(walk(app.routes)) == known


async def test_all_ways_to_be_nobody_look_alike(running: Running, store: TokenStore) -> None:
    expired = store.create("gone", ("read:status",), 1e-6)
    revoked = store.create("revoked", ("read:status",), None)
    store.revoke(revoked.id)
    unknown = f"vc_{'0' * 12}_{'0' * 64}"
    given: list[list[tuple[str, str]]] = [
        [],
        [("Authorization", "")],
        [("Authorization", "nonsense")],
        *(
            [("Authorization", f"Bearer {token}")]
            for token in (expired.secret, revoked.secret, unknown)
        ),
        [*bearer(store, "read:status").items()] * 2,
    ]
    answers = set()
    async with running(admission=Admission(tokens=store)) as client:
        for headers in given:
            for path in ("/v1/status", "/v1/nothing"):
                answer = await client.get(path, headers=[*headers, ("X-Request-Id", "same")])
                assert answer.status_code == 401
                assert answer.headers["content-type"] == PROBLEM_MEDIA_TYPE
                assert answer.headers["www-authenticate"] == 'Bearer realm="veilcam"'
                answers.add(answer.text.replace(path, "").rstrip())
    assert len(answers) == 1


async def test_raw_embeddings_want_a_scope_more(
    running: Running, bench: Bench, store: TokenStore
) -> None:
    ordinary = bearer(store, "read:embedding", "classify")
    full = bearer(store, "read:embedding", "read:embedding:raw", "classify")
    classify = bearer(store, "classify")
    wanted = {"include_embedding": True}
    async with running(admission=Admission(tokens=store)) as client:
        for headers, scope in ((ordinary, "read:embedding:raw"), (classify, "read:embedding")):
            for path in ("/v1/captures", "/v1/classifications"):
                body = wanted if "class" in path else None
                answer = await client.post(path, headers=headers, json=body)
                assert answer.json()["code"] == "forbidden"
                assert f"the scope {scope}:" in answer.json()["detail"]
        assert bench.sensor.captures == 0
        assert (await client.post("/v1/classifications", headers=classify)).is_success
        assert (await client.post("/v1/captures", headers=full)).is_success
        answer = await client.post("/v1/classifications", headers=full, json=wanted)
        assert answer.json()["embedding"]["form"] == "raw"


async def test_idempotency_key_is_a_caller_s_own(
    running: Running, store: TokenStore, bench: Bench
) -> None:
    key = {"Idempotency-Key": "k"}
    scopes: tuple[Scope, ...] = ("read:embedding", "read:embedding:raw")
    first, second = bearer(store, *scopes), bearer(store, *scopes)
    async with running(admission=Admission(tokens=store)) as client:
        answers = [
            await client.post("/v1/captures", headers={**key, **headers})
            for headers in (first, second, first)
        ]
    assert bench.sensor.captures == 2
    assert answers[0].content == answers[2].content != answers[1].content


async def test_caller_that_asks_too_often_waits_and_others_do_not(
    running: Running, store: TokenStore
) -> None:
    now = 0.0
    admission = Admission(tokens=store, rate=RateLimit(0.5, 2, lambda: now))
    hasty, other = bearer(store, "read:status"), bearer(store, "read:status")
    async with running(admission=admission) as client:

        async def ask(headers: dict[str, str]) -> int:
            return (await client.get("/v1/status", headers=headers)).status_code

        assert [await ask(hasty) for _ in range(3)] == [200, 200, 429]
        refused = await client.get("/v1/status", headers=hasty)
        assert refused.json()["code"] == "too_many_requests"
        assert refused.headers["retry-after"] == "2"
        assert await ask(other) == 200
        # Who guesses is slowed down, and locks nobody out.
        assert [await ask({}) for _ in range(3)] == [401, 401, 429]
        assert await ask(other) == 200
        now = 2.0
        assert [await ask(hasty) for _ in range(2)] == [200, 429]


async def test_events_end_with_their_token_and_tell_labels_to_who_may_know_them(
    running: Running, store: TokenStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(events, "RECHECK", 0.0)
    heard, passed, told = list[str](), list[str](), events._told

    def noted(event: Event, caller: Caller) -> Event:
        passed.append(event.kind)
        return told(event, caller)

    monkeypatch.setattr(events, "_told", noted)
    worker = bearer(store, "classify", "read:status", "mask:rotate")
    more: tuple[Scope, ...]
    async with running(admission=Admission(tokens=store)) as client:
        for more in ((), ("classify",)):
            token = store.create("one", ("read:status", *more), None)
            headers = {"Authorization": f"Bearer {token.secret}", "Last-Event-ID": "0-0"}
            listening = asyncio.create_task(client.get("/v1/events", headers=headers))
            assert (await client.post("/v1/classifications", headers=worker)).is_success
            assert (await client.post("/v1/rotation/advance", headers=worker)).is_success
            await until(lambda: "mask" in passed)
            passed.clear()
            store.revoke(token.id)
            heard.append((await listening).text)
    assert "event: capture" in heard[0]
    assert "event: classification" in heard[1]
    assert "classification" not in heard[0]
    assert "label" not in heard[0]


def test_buckets_of_callers_are_bounded() -> None:
    limit = RateLimit(1.0, 1, lambda: 0.0)
    for number in range(5000):
        limit.take(str(number))
    assert len(limit._buckets) <= 1024


async def test_so_many_requests_at_once(running: Running, store: TokenStore, bench: Bench) -> None:
    go_on = threading.Event()
    admission = Admission(tokens=store, concurrency=ConcurrencyLimit(1))
    headers, other = bearer(store, "classify"), bearer(store, "read:status")
    bench.sensor.before = lambda: (go_on.wait(100), None)[1]
    async with running(admission=admission) as client:
        first = asyncio.create_task(client.post("/v1/classifications", headers=headers))
        while (await client.get("/v1/status", headers=other)).json()["queue"]["waiting"] == 0:
            await asyncio.sleep(0.01)
        refused = await client.post("/v1/classifications", headers=headers)
        assert refused.json()["code"] == "too_many_requests"
        assert int(refused.headers["retry-after"]) >= 1
        go_on.set()
        assert (await first).is_success
        assert (await client.post("/v1/classifications", headers=headers)).is_success


async def test_daemon_without_tokens_says_how_to_make_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = Settings(bundle=tmp_path / "a.veilcam", state_dir=tmp_path / "state")
    with open_admission(settings) as admission:
        assert admission.tokens is not None
        admission.tokens.create("first", ("classify",), None)
    assert "sudo veilcamd token first" in capsys.readouterr().out
    with open_admission(settings):
        pass
    assert capsys.readouterr().out == ""


async def test_one_caller_leaves_streams_to_others(running: Running, store: TokenStore) -> None:
    admission = Admission(
        tokens=store,
        streams=ConcurrencyLimit(3),
        streams_of_one=ConcurrencyLimit(2),
    )
    one, other, third = (bearer(store, "read:status") for _ in range(3))
    async with running(admission=admission) as client, asyncio.timeout(300):
        streams: list[asyncio.Task[httpx.Response]] = []
        for number, headers in enumerate((one, one, other), 1):
            streams.append(asyncio.create_task(client.get("/v1/events", headers=headers)))
            while admission.streams._under_way.total() < number:
                await asyncio.sleep(0.001)
            if number == 2:
                refused = await client.get("/v1/events", headers=one)
                assert refused.json()["code"] == "too_many_requests"
                assert "2 of your requests" in refused.json()["detail"]
        refused = await client.get("/v1/events", headers=third)
        assert "3 of your requests" in refused.json()["detail"]
        assert not any(stream.done() for stream in streams)
        for stream in streams:
            stream.cancel()


async def test_caller_is_the_peer_where_no_tokens_are_wanted() -> None:
    admission = Admission()
    with admission.admitted(Headers(), "127.0.0.2") as caller:
        assert caller.id == "127.0.0.2"
        assert caller.scopes == frozenset(SCOPES)


async def test_limits_are_those_of_the_settings(tmp_path: Path) -> None:
    settings = Settings(
        bundle=tmp_path / "a.veilcam",
        state_dir=tmp_path / "state",
        callers=1,
    )
    with open_admission(settings) as admission, ExitStack() as stack:
        with pytest.raises(ProblemError):
            deque(map(admission.rate.take, 1000 * ["a"]))
        for limit, most in (
            (admission.concurrency, settings.concurrency),
            (admission.streams, settings.streams),
            (admission.streams_of_one, settings.caller_streams),
            (admission.uploads, 4),
            (admission.uploads_of_one, 2),
        ):
            for name in ("b", *most * "a"):
                stack.enter_context(limit.held(name))
            with pytest.raises(ProblemError):
                stack.enter_context(limit.held("a"))
