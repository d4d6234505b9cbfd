"""What every answer tells a browser, and what no page can send."""

from __future__ import annotations

import json
from collections import Counter
from typing import TYPE_CHECKING

import anyio
import anyio.lowlevel
import httpx
import pytest
from starlette.types import Message
from tests.unit.server.api.conftest import bearer
from tests.unit.server.api.test_page import POLICY

from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE
from veilcam_client.wire.tokens import SCOPES
from veilcam_server.api.app import MAX_BODY, create_app
from veilcam_server.security.admission import Admission
from veilcam_server.security.limits import ConcurrencyLimit, RateLimit
from veilcam_server.security.tokens import TokenStore

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from tests.unit.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio

HEADERS = {
    "x-content-type-options": "nosniff",
    "cross-origin-resource-policy": "same-origin",
    "content-security-policy": (
        "default-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "referrer-policy": "no-referrer",
}
PAGE_CAN_SEND = (
    "text/plain",
    "text/plain; charset=utf-8",
    "multipart/form-data; boundary=x",
    "application/x-www-form-urlencoded",
    "",
)
"""Without asking first (https://fetch.spec.whatwg.org/#cors-safelisted-request-header)."""


def check(answer: httpx.Response) -> int:
    # What has a tag is kept by who asked, who asks each time whether it still holds.
    kept = "private, no-cache" if "etag" in answer.headers else "no-store"
    if "veilcam-padding" in answer.headers and "json" in answer.headers["content-type"]:
        kept = "no-store, no-transform"
    assert answer.headers.get_list("cache-control") == [kept]
    page = answer.status_code == 200 and answer.url.path in ("/", "/docs")
    # What the two pages may load: test_page.py.
    policy = {"content-security-policy": POLICY} if page else {}
    assert {name: answer.headers.get_list(name) for name in HEADERS} == {
        name: [value] for name, value in {**HEADERS, **policy}.items()
    }, (answer.request, answer.status_code)
    return answer.status_code


@pytest.mark.slow
async def test_every_answer_of_every_route_tells_a_browser_to_make_nothing_of_it(
    running: Running, bench: Bench, store: TokenStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    token = bearer(store, *SCOPES)
    # A stream that is let in would not end here: it is refused for its number.
    admission = Admission(store, streams=ConcurrencyLimit(0))
    statuses: Counter[int] = Counter()
    async with running(admission=admission, raising=False) as client:
        document = (await client.get("/v1/openapi.json", headers=token)).json()
        asked = [
            (method, "/".join("0" * 12 if "{" in part else part for part in path.split("/")))
            for path, operations in document["paths"].items()
            for method in (*operations, "options", "trace")
        ]
        for method, path in [*asked, ("get", "/nothing"), ("brew", "/")]:
            for headers in (
                token,
                {},
                {**token, "Host": "page.example"},
                {**token, "Origin": "https://page.example"},
                {**token, "Content-Type": "text/plain"},
                {**token, "Content-Type": "application/json"},
            ):
                body = b"" if method == "get" else b"{"
                answer = await client.request(method, path, headers=headers, content=body)
                statuses[check(answer)] += 1
        json_body = {**token, "Content-Type": "application/json"}
        large = await client.put("/v1/rotation", headers=json_body, content=bytes(MAX_BODY + 1))
        statuses[check(large)] += 1

        def fail() -> None:
            raise RuntimeError

        bench.sensor.before = fail
        statuses[check(await client.post("/v1/captures", headers=token))] += 1
    assert {200, 401, 403, 404, 405, 413, 415, 421, 422, 429, 500} <= set(statuses)


async def test_caller_refused_for_haste_is_told_too(running: Running) -> None:
    async with running(admission=Admission(rate=RateLimit(1e-9, 1))) as client:
        assert [check(await client.get("/v1/status")) for _ in range(2)] == [200, 429]


async def test_stream_of_events_is_told_too(bench: Bench) -> None:
    service = bench.service(bench.camera())
    app, heads = create_app(service), list[httpx.Headers]()
    listener = anyio.CancelScope()
    asked = iter([{"type": "http.request"}])

    async def receive() -> Message:
        for message in asked:
            return message
        await anyio.sleep_forever()
        raise AssertionError

    async def send(message: Message) -> None:
        heads.append(httpx.Headers(message["headers"]))
        listener.cancel()

    scope = {
        "type": "http",
        "method": "GET",
        "path": "/v1/events",
        "query_string": b"",
        "headers": [(b"host", b"localhost")],
    }
    async with service.open():
        with listener:
            await app(scope, receive, send)
    (head,) = heads
    assert head["content-type"].startswith("text/event-stream")
    assert {**HEADERS, "cache-control": "no-store"}.items() <= dict(head).items()


@pytest.mark.parametrize("media_type", PAGE_CAN_SEND)
async def test_no_body_is_taken_that_a_page_can_send_unasked(
    running: Running, bench: Bench, media_type: str
) -> None:
    headers = {"Content-Type": media_type} if media_type else {}
    body = json.dumps({"mode": "captures", "captures": 7}).encode()
    async with running() as client:
        before = (await client.get("/v1/rotation")).json()["policy"]
        for method, path in (
            ("PUT", "/v1/rotation"),
            ("POST", "/v1/captures"),
            ("POST", "/v1/classifications"),
            ("POST", "/v1/rotation/advance"),
            ("POST", "/v1/lease"),
            ("POST", "/v1/calibration"),
            ("POST", "/v1/bundles"),
            ("PUT", "/v1/simulation/scene"),
            ("POST", f"/v1/bundles/{'0' * 64}/activate"),
        ):
            answer = await client.request(method, path, content=body, headers=headers)
            assert answer.status_code == 415, (method, path)
            assert answer.json()["code"] == "unsupported_media_type"
        assert (await client.get("/v1/rotation")).json()["policy"] == before
    assert bench.sensor.captures == 0
    assert len(bench.display.shown) == 2  # the first mask, and opaque at the end


async def test_body_is_what_its_media_type_says(running: Running) -> None:
    policy = json.dumps({"mode": "captures", "captures": 7}).encode()

    async def chunks() -> AsyncIterator[bytes]:
        yield policy

    async with running() as client:
        for media_type, status in (
            ("application/json", 200),
            ("Application/JSON; charset=utf-8", 200),
            ("application/json-patch+json", 415),
            ("text/json", 415),
            (BUNDLE_MEDIA_TYPE, 415),
        ):
            for content in (policy, chunks()):
                answer = await client.put(
                    "/v1/rotation", content=content, headers={"Content-Type": media_type}
                )
                assert answer.status_code == status, media_type
        # What is empty needs no name, but an upload does.
        assert (await client.post("/v1/captures")).status_code == 200
        answer = await client.post("/v1/bundles")
        assert answer.json()["detail"] == f"send it with Content-Type: {BUNDLE_MEDIA_TYPE}"
