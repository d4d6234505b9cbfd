"""Conditional requests: what a caller has is not sent again."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    import httpx
    from tests.unit.server.conftest import Running

pytestmark = pytest.mark.anyio


async def tag_of(client: httpx.AsyncClient, path: str) -> str:
    answer = await client.get(path)
    assert answer.status_code == 200
    assert answer.headers["cache-control"] == "private, no-cache"
    tag: str = answer.headers["etag"]
    assert tag.startswith('W/"')
    return tag


async def test_status_has_one_tag_until_something_happens(running: Running) -> None:
    async with running() as client:
        first = (await client.get("/v1/status")).json()
        tag = await tag_of(client, "/v1/status")
        await asyncio.sleep(0.01)
        later = (await client.get("/v1/status")).json()
        assert later["uptime_s"] > first["uptime_s"]
        assert later["rotation"]["epoch_age_s"] > first["rotation"]["epoch_age_s"]
        # Time went by, and nothing happened.
        assert await tag_of(client, "/v1/status") == tag
        tags = {tag}
        for method, path, body in (
            ("POST", "/v1/captures", None),
            ("POST", "/v1/rotation/advance", None),
            ("PUT", "/v1/rotation", {"mode": "captures", "captures": 7}),
        ):
            assert (await client.request(method, path, json=body)).status_code == 200
            tags.add(await tag_of(client, "/v1/status"))
        assert len(tags) == 4


@pytest.mark.parametrize("path", ["/v1/status", "/v1/bundles"])
async def test_answer_known_already_is_not_sent_again(running: Running, path: str) -> None:
    async with running() as client:
        document = (await client.get("/v1/openapi.json")).json()
        assert "304" in document["paths"][path]["get"]["responses"]
        tag = await tag_of(client, path)
        strong = tag.removeprefix("W/")
        for known in (tag, strong, f'"other", {tag}', f'{strong},W/"x"', "*", " * "):
            answer = await client.get(path, headers={"If-None-Match": known})
            assert (answer.status_code, answer.content) == (304, b""), known
            assert answer.headers["etag"] == tag
            assert "content-type" not in answer.headers
            head = await client.head(path, headers={"If-None-Match": known})
            assert (head.status_code, head.headers["etag"]) == (304, tag)
        for other in ("", '"other"', strong.strip('"'), strong[:-2] + '"', "W/", '"*"'):
            answer = await client.get(path, headers={"If-None-Match": other})
            assert (answer.status_code, bool(answer.content)) == (200, True), other


async def test_bundles_have_another_tag_when_another_is_installed(
    running: Running, upload: bytes
) -> None:
    async with running() as client:
        before = await tag_of(client, "/v1/bundles")
        headers = {"Content-Type": "application/vnd.veilcam.bundle"}
        answer = await client.post("/v1/bundles", content=upload, headers=headers)
        assert answer.status_code == 201
        after = await tag_of(client, "/v1/bundles")
        await client.delete(f"/v1/bundles/{answer.json()['digest']}")
        assert after != before == await tag_of(client, "/v1/bundles")
