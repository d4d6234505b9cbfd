"""Conditional requests: what a caller has is not sent again."""

from __future__ import annotations

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


async def test_answer_known_already_is_not_sent_again(running: Running) -> None:
    path = "/v1/bundles"
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
