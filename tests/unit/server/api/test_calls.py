"""Names in every answer: of its request, and of the run of the daemon."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from veilcam_client.wire.base import CALL_HEADER, RUN_HEADER
from veilcam_server.api.app import MAX_BODY
from veilcam_server.security.admission import Admission
from veilcam_server.security.tokens import TokenStore

if TYPE_CHECKING:
    from tests.unit.server.conftest import Running

pytestmark = pytest.mark.anyio

NAME = "0123456789abcdef" * 2
JSON = {"Content-Type": "application/json"}


@pytest.mark.parametrize(
    ("method", "path", "more", "status"),
    [
        ("GET", "/v1/status", {}, 200),
        ("GET", "/v1/bundles", {"headers": {"If-None-Match": "*"}}, 304),
        ("HEAD", "/v1/events", {}, 200),
        ("GET", "/", {}, 200),
        ("GET", "/healthz", {}, 200),
        ("GET", "/v1/nothing", {}, 404),
        ("DELETE", "/v1/status", {}, 405),
        ("GET", "/v1/status", {"headers": {"Host": "page.example"}}, 421),
        ("PUT", "/v1/rotation", {"content": b"{}"}, 415),
        ("PUT", "/v1/rotation", {"content": b"{}", "headers": JSON}, 422),
        ("PUT", "/v1/rotation", {"content": b" " * (MAX_BODY + 1), "headers": JSON}, 413),
        ("POST", "/v1/captures", {}, 200),
    ],
)
async def test_call_and_run_are_named_in_every_answer(
    running: Running, method: str, path: str, more: dict[str, Any], status: int
) -> None:
    headers, admission = {**more.pop("headers", {}), CALL_HEADER: NAME}, Admission()
    async with running(admission=admission) as client:
        answer = await client.request(method, path, headers=headers, **more)
    assert (answer.status_code, answer.headers[CALL_HEADER]) == (status, NAME)
    assert answer.headers[RUN_HEADER] == admission.keys.run


async def test_call_without_a_token_is_named_too(running: Running, store: TokenStore) -> None:
    async with running(admission=Admission(store)) as client:
        answer = await client.get("/v1/status", headers={CALL_HEADER: NAME})
    assert (answer.status_code, answer.headers[CALL_HEADER]) == (401, NAME)
    assert len(answer.headers[RUN_HEADER]) == 32


@pytest.mark.parametrize("given", [None, "", NAME[:-1], NAME + "0", NAME[:-1] + "g", f"{NAME}, "])
async def test_call_that_is_not_32_digits_is_not_repeated(
    running: Running, given: str | None
) -> None:
    async with running() as client:
        for path in ("/v1/status", "/v1/nothing"):
            answer = await client.get(path, headers={} if given is None else {CALL_HEADER: given})
            assert CALL_HEADER not in answer.headers


async def test_call_that_is_named_twice_is_not_repeated(running: Running) -> None:
    async with running() as client:
        answer = await client.get("/v1/status", headers=[(CALL_HEADER, NAME)] * 2)
    assert CALL_HEADER not in answer.headers
