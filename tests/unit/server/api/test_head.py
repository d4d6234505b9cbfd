"""HEAD: what GET would answer, without its body."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest
from tests.unit.server.api.conftest import bearer

from veilcam_client.wire.tokens import SCOPES
from veilcam_server.security.admission import Admission
from veilcam_server.security.tokens import TokenStore

if TYPE_CHECKING:
    from tests.unit.server.conftest import Running

pytestmark = pytest.mark.anyio

OWN = ("x-request-id", "etag", "content-length")
"""Headers of which every answer has its own; what counts requests is longer for each."""


@pytest.mark.slow
async def test_every_get_has_its_head(running: Running, store: TokenStore) -> None:
    token = bearer(store, *SCOPES)
    async with running(admission=Admission(store)) as client:
        paths = (await client.get("/v1/openapi.json", headers=token)).json()["paths"]
        asked = [path for path, operations in paths.items() if "get" in operations]
        assert len(asked) > 8
        for path in [*asked, "/v1/nothing"]:
            for headers in (token, {}, {**token, "Host": "page.example"}):
                head = await client.head(path, headers=headers)
                assert head.content == b""
                if path == "/v1/events" and headers == token:
                    # A stream: it has no end that GET could come to.
                    assert head.status_code == 200
                    assert head.headers["content-type"].startswith("text/event-stream")
                    continue
                body = await client.get(path, headers=headers)
                assert body.content
                assert head.status_code == body.status_code
                assert dict(head.headers).keys() == dict(body.headers).keys()
                for name in set(head.headers) - set(OWN):
                    assert head.headers[name] == body.headers[name], (path, name)


async def test_method_that_a_path_does_not_take_is_told_those_it_takes(running: Running) -> None:
    async with running() as client:
        paths = (await client.get("/v1/openapi.json")).json()["paths"]
        assert len(paths) > 20
        for path, operations in paths.items():
            taken = {method.upper() for method in operations}
            if "GET" in taken:
                taken.add("HEAD")
            for method in {"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"} - taken:
                answer = await client.request(method, re.sub(r"\{\w+\}", "x", path))
                assert answer.status_code == 405, (method, path)
                assert answer.headers["allow"] == ", ".join(sorted(taken)), (method, path)


async def test_stream_that_is_not_read_holds_no_place(running: Running) -> None:
    admission = Admission()
    async with running(admission=admission) as client:
        for _ in range(100):
            assert (await client.head("/v1/events")).status_code == 200
        metrics = (await client.get("/v1/metrics")).text
    assert 'method="HEAD",route="/v1/events",status="200"} 100.0' in metrics
