"""HEAD: what GET would answer, without its body."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

from veilcam_client.wire.tokens import SCOPES
from veilcam_server.security.admission import Admission
from veilcam_server.security.audit import REFUSED, AuditLog
from veilcam_server.security.tokens import TokenStore

if TYPE_CHECKING:
    from pathlib import Path

    from tests.unit.server.conftest import Running

pytestmark = pytest.mark.anyio

OWN = ("x-request-id", "etag", "content-length")
"""Headers of which every answer has its own; what counts requests is longer for each."""


@pytest.mark.slow
async def test_every_get_has_its_head(running: Running, tmp_path: Path) -> None:
    store, refused = TokenStore(tmp_path / "tokens"), AuditLog(tmp_path / REFUSED)
    token = {"Authorization": f"Bearer {store.create('all', SCOPES, None).secret}"}
    admission = Admission(store, refused=refused)
    async with running(admission=admission) as client:
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
    refused.close()


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


async def test_head_is_refused_where_there_is_no_get(running: Running) -> None:
    async with running() as client:
        head = await client.head("/v1/captures")
        assert (head.status_code, head.headers["allow"]) == (405, "POST")
        assert (await client.delete("/v1/status")).headers["allow"] == "GET, HEAD"
