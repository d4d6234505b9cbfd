"""Requests of a page of another site, sent by a browser: refused everywhere, before all else."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest
from starlette.types import Message
from tests.unit.server.api.conftest import bearer
from tests.unit.server.logs import events, open_log

from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE
from veilcam_client.wire.tokens import SCOPES
from veilcam_server.api.app import create_app
from veilcam_server.security.admission import Admission
from veilcam_server.security.limits import ConcurrencyLimit
from veilcam_server.security.site import Site
from veilcam_server.security.tokens import TokenStore

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio

NAVIGATION = [("Sec-Fetch-Mode", "navigate"), ("Sec-Fetch-Dest", "document")]
"""A link was followed, to a page of its own."""
LINKED = (("get", "/"), ("get", "/docs"))
"""What such a link may lead to."""
FOREIGN: list[list[tuple[str, str]]] = [
    [("Origin", "https://page.example")],
    [("Origin", "null")],
    [("Origin", "")],
    [("Origin", "localhost")],
    [("Origin", "file://localhost")],
    [("Origin", "http://localhost:8787")],
    [("Origin", "http://localhost.page.example")],
    [("Origin", "http://localhost"), ("Origin", "https://page.example")],
    [("Origin", "http://localhost"), ("Sec-Fetch-Site", "cross-site")],
    [("Origin", "https://page.example"), ("Sec-Fetch-Site", "none")],
    [("Sec-Fetch-Site", "cross-site")],
    [("Sec-Fetch-Site", "same-site")],
    [("Sec-Fetch-Site", "")],
    [("Sec-Fetch-Site", "same-origin"), ("Sec-Fetch-Site", "cross-site")],
    [("Sec-Fetch-Site", "cross-site"), *NAVIGATION],
    [("Origin", "https://page.example"), ("Sec-Fetch-Site", "cross-site"), *NAVIGATION],
]
MEDIA_TYPES = {
    ("post", "/v1/bundles"): BUNDLE_MEDIA_TYPE,
    ("put", "/v1/simulation/scene"): "image/png",
}
"""Of what is no JSON."""
BODIES: dict[tuple[str, str], Any] = {
    ("put", "/v1/rotation"): {"mode": "captures", "captures": 7},
    ("post", "/v1/classifications"): {"include_embedding": True},
    ("post", "/v1/tokens"): {"label": "lamp", "scopes": ["classify"], "seconds": 60},
    ("post", "/v1/lease"): {"owner": "a page", "seconds": 60},
    ("post", "/v1/calibration"): {"repeats": 2},
    ("post", "/v1/calibration/scene"): {"scene": "lamp"},
}
"""What a route wants besides the upload of a bundle; without it nothing would be asked of it."""


@pytest.fixture
def admission(tmp_path: Path, store: TokenStore) -> Iterator[Admission]:
    """Of a daemon that wants tokens, keeps its log, and can open no event stream."""
    log = open_log(tmp_path)
    # A stream that is let in would not end: it is let in if it is refused for its number.
    yield Admission(store, log=log, streams=ConcurrencyLimit(0))
    log.close()


@pytest.fixture
def token(store: TokenStore) -> dict[str, str]:
    return bearer(store, *SCOPES)


async def requests(
    client: httpx.AsyncClient, token: dict[str, str], bundle: bytes
) -> list[tuple[str, str, bytes]]:
    """Method, path and body for every route of the API."""
    document = (await client.get("/v1/openapi.json", headers=token)).json()
    return [
        (
            method,
            "/".join("0" * 12 if "{" in part else part for part in path.split("/")),
            bundle
            if (method, path) == ("post", "/v1/bundles")
            else json.dumps(BODIES[method, path]).encode()
            if (method, path) in BODIES
            else b"",
        )
        for path, operations in document["paths"].items()
        for method in operations
    ]


def media_type(method: str, path: str) -> tuple[str, str]:
    return "Content-Type", MEDIA_TYPES.get((method, path), "application/json")


async def state(client: httpx.AsyncClient, token: dict[str, str], bench: Bench) -> dict[str, Any]:
    """All that a request could have changed, but for how long the epoch has lasted."""
    paths = ("rotation", "bundles", "tokens", "lease", "calibration")
    found = {path: (await client.get(f"/v1/{path}", headers=token)).json() for path in paths}
    found["rotation"] = {name: found["rotation"][name] for name in ("policy", "epoch")}
    found["panel"], found["captures"] = len(bench.display.shown), bench.sensor.captures
    return found


@pytest.mark.thorough
@pytest.mark.parametrize("headers", FOREIGN)
async def test_every_route_refuses_before_it_reads_or_does_anything(
    running: Running,
    bench: Bench,
    *,
    upload: bytes,
    admission: Admission,
    token: dict[str, str],
    tmp_path: Path,
    headers: list[tuple[str, str]],
) -> None:
    read = 0

    async def counted(body: bytes) -> AsyncIterator[bytes]:
        nonlocal read
        read += 1
        yield body

    async with running(admission=admission) as client:
        asked = await requests(client, token, upload)
        assert {("get", "/v1/events"), ("post", "/v1/bundles")} <= {each[:2] for each in asked}
        asked += [("options", "/v1/rotation", b""), ("get", "/docs", b"")]
        if headers == [("Sec-Fetch-Site", "cross-site"), *NAVIGATION]:
            asked = [each for each in asked if each[:2] not in LINKED]
        before = await state(client, token, bench)
        for method, path, body in asked:
            for known in (token, {}):
                answer = await client.request(
                    method,
                    path,
                    headers=[*headers, *known.items(), media_type(method, path)],
                    content=counted(body),
                )
                assert answer.status_code == 403, (method, path)
                assert answer.json()["code"] == "cross_site"
        assert await state(client, token, bench) == before
    assert read == 0
    assert events(tmp_path, "request") == []
    refused = events(tmp_path, "refused")
    assert [entry["code"] for entry in refused] == ["cross_site"] * 2 * len(asked)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Origin": "http://localhost"},
        {"Origin": "http://localhost:80", "Sec-Fetch-Site": "same-origin"},
        {"Origin": "https://LOCALHOST:443"},
        {"Sec-Fetch-Site": "none", **dict(NAVIGATION)},
        {"Host": "127.0.0.1:8787", "Origin": "http://127.0.0.1:8787"},
        {"Host": "[::1]", "Origin": "http://[::1]"},
        {"Host": "[::1]:443", "Origin": "https://[::1]"},
    ],
)
async def test_same_requests_of_a_program_or_of_the_same_origin_do_what_they_say(
    running: Running,
    bench: Bench,
    *,
    upload: bytes,
    admission: Admission,
    token: dict[str, str],
    headers: dict[str, str],
) -> None:
    codes = {}
    async with running(admission=admission) as client:
        before = await state(client, token, bench)
        for method, path, body in await requests(client, token, upload):
            answer = await client.request(
                method,
                path,
                headers=dict([*token.items(), *headers.items(), media_type(method, path)]),
                content=body,
            )
            codes[method, path] = None if answer.is_success else answer.json()["code"]
        after = await state(client, token, bench)
    # What this camera cannot do, or has not got, is refused by the route itself.
    assert set(codes.values()) == {
        None,
        "too_many_requests",
        "not_found",
        "invalid_request",
        "conflict",
        "calibration_impossible",
        "not_enabled",
    }
    assert codes["get", "/v1/events"] == "too_many_requests"
    assert all(codes[each] is None for each in BODIES if "calibration" not in each[1])
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {"rotation", "bundles", "tokens", "panel", "captures"}


@pytest.mark.slow
async def test_no_get_changes_anything(
    running: Running, bench: Bench, *, upload: bytes, admission: Admission, token: dict[str, str]
) -> None:
    """Browsers send neither header with what a link or a picture asks of a plain LAN address."""
    async with running(admission=admission) as client:
        before = await state(client, token, bench)
        gets = [
            path for method, path, _ in await requests(client, token, upload) if method == "get"
        ]
        assert len(gets) > 8
        for path in gets:
            for method in ("GET", "HEAD"):
                for query in ("", "?force=true&mode=off&captures=1&scene=lamp"):
                    await client.request(method, path + query, headers=token)
        assert await state(client, token, bench) == before


@pytest.mark.parametrize(
    ("method", "path", "change", "status"),
    [
        ("GET", "/", {}, 200),
        ("GET", "/docs", {}, 200),
        ("GET", "/page/app.js", {}, 403),
        ("HEAD", "/", {}, 403),
        ("POST", "/", {}, 403),
        ("GET", "/v1/status", {}, 403),
        ("GET", "/docs/", {}, 403),
        ("GET", "/?next=/v1/status", {}, 200),
        ("GET", "/", {"Sec-Fetch-Dest": "iframe"}, 403),
        ("GET", "/", {"Sec-Fetch-Dest": "image"}, 403),
        ("GET", "/", {"Sec-Fetch-Mode": "no-cors"}, 403),
        ("GET", "/", {"Origin": "https://page.example"}, 403),
        ("GET", "/", {"Host": "page.example"}, 421),
    ],
)
async def test_link_on_another_site_leads_to_pages_alone(
    running: Running, *, method: str, path: str, change: dict[str, str], status: int
) -> None:
    headers = {"Sec-Fetch-Site": "cross-site", **dict(NAVIGATION), **change}
    async with running() as client:
        answer = await client.request(method, path, headers=headers)
        assert answer.status_code == status


async def test_frame_is_let_in_where_a_page_may_have_one(running: Running) -> None:
    headers = {"Sec-Fetch-Site": "cross-site", **dict(NAVIGATION), "Sec-Fetch-Dest": "iframe"}
    admission = Admission(site=Site(frame_ancestors=("https://home.example", "http://b:1")))
    async with running(admission=admission) as client:
        answer = await client.get("/", headers=headers)
        assert answer.status_code == 200
        policy = answer.headers["content-security-policy"]
        assert policy.endswith("frame-ancestors https://home.example http://b:1")
        assert (await client.get("/v1/status", headers=headers)).status_code == 403


async def test_port_that_is_no_default_is_compared(running: Running) -> None:
    async with running() as client:
        for host, origin, status in (
            ("localhost:8787", "http://localhost:8787", 200),
            ("localhost:8787", "http://localhost", 403),
            ("localhost:8787", "http://127.0.0.1:8787", 403),
            ("localhost:443", "http://localhost", 403),
        ):
            answer = await client.get("/v1/status", headers={"Host": host, "Origin": origin})
            assert answer.status_code == status, (host, origin)


async def test_web_sockets_are_closed(bench: Bench) -> None:
    app, sent = create_app(bench.service(bench.camera())), []

    async def receive() -> Message:
        return {"type": "websocket.connect"}

    async def send(message: Message) -> None:
        sent.append(message["type"])

    for path in app.openapi()["paths"]:
        scope = {"type": "websocket", "path": path, "query_string": b"", "headers": []}
        await app(scope, receive, send)
    assert set(sent) == {"websocket.close"}
