"""Tokens over the API, a page at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.unit.server.api.conftest import bearer

from veilcam_client.async_camera import AsyncCamera
from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE
from veilcam_client.wire.tokens import MOST_TOKENS, TOKENS_AT_ONCE
from veilcam_server.api.routes import simulation
from veilcam_server.security.admission import Admission
from veilcam_server.security.tokens import TokenStore

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    import httpx
    from tests.unit.server.conftest import Running

pytestmark = pytest.mark.anyio


async def page(client: httpx.AsyncClient, **query: Any) -> tuple[list[str], str | None]:
    answer = (await client.get("/v1/tokens", params=query)).json()
    return [token["label"] for token in answer["tokens"]], answer["next"]


async def test_tokens_come_a_page_at_a_time(running: Running, store: TokenStore) -> None:
    made = [store.create(f"{number}", ("admin:tokens",), None) for number in range(7)]
    labels = [token.label for token in made]
    admission = Admission(store)
    async with running(admission=admission) as client:
        client.headers["Authorization"] = f"Bearer {made[0].secret}"
        assert await page(client) == (labels, None)
        assert await page(client, limit=7) == (labels, None)
        assert await page(client, limit=3) == (labels[:3], made[2].id)
        assert await page(client, limit=3, after=made[2].id) == (labels[3:6], made[5].id)
        assert await page(client, limit=3, after=made[5].id) == (labels[6:], None)
        assert await page(client, after=made[6].id) == ([], None)
        # One that is revoked keeps its place.
        await client.delete(f"/v1/tokens/{made[2].id}")
        assert await page(client, limit=1, after=made[2].id) == (labels[3:4], made[3].id)
        for query, code in (
            ({"limit": 0}, "invalid_request"),
            ({"limit": MOST_TOKENS + 1}, "invalid_request"),
            ({"after": "x"}, "invalid_request"),
            ({"after": "0" * 12}, "not_found"),
        ):
            answer = await client.get("/v1/tokens", params=query)
            assert answer.json()["code"] == code, query


async def test_no_answer_has_more_than_it_should(
    running: Running, store: TokenStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = store.create("one", ("admin:tokens",), None)
    many = (store.tokens()[0],) * (TOKENS_AT_ONCE + 1)
    monkeypatch.setattr(store, "tokens", lambda: many)
    async with running(admission=Admission(store)) as client:
        camera = AsyncCamera("http://localhost", http_client=client, token=one.secret)
        first = await camera.tokens.list()
        assert (len(first.tokens), first.next) == (TOKENS_AT_ONCE, one.id)
        assert len((await camera.tokens.list(limit=MOST_TOKENS)).tokens) == TOKENS_AT_ONCE + 1


@pytest.mark.parametrize(
    ("method", "path", "media_type"),
    [
        ("POST", "/v1/bundles", BUNDLE_MEDIA_TYPE),
        ("PUT", simulation.PATH, "image/png"),
    ],
)
async def test_upload_without_the_right_to_it_is_not_read(
    running: Running, store: TokenStore, method: str, path: str, media_type: str
) -> None:
    async def body() -> AsyncIterator[bytes]:
        for _ in range(3):
            reads.append(path)
            yield b"a"

    reads: list[str] = []
    async with running(admission=Admission(store)) as client:
        client.headers["Content-Type"] = media_type
        assert (await client.request(method, path, content=body())).status_code == 401
        assert (await client.put("/v1/rotation", content=body())).status_code == 401
        client.headers.update(bearer(store, "read:status", "classify"))
        assert (await client.request(method, path, content=body())).status_code == 403
    assert not reads
