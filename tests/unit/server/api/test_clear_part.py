"""What an answer says in the clear is a closed list."""

from __future__ import annotations

from typing import Any

import httpx
import pytest
from tests.unit.server.conftest import Bench, Running

from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.sealing import Release

pytestmark = pytest.mark.anyio

CLEAR = {"id", "epoch", "number", "taken_at"}
OPEN = {"form", "shape", "values"}
SEALED = {"form", "shape", "dtype", "block", "envelope"}
ENVELOPE = {"version", "device", "epoch", "bundle", "keys", "signature"}
LABEL = {"label", "confidence", "scores"}


def said(part: dict[str, Any]) -> set[str]:
    """Names of what is there: nothing is said by a null."""
    return {name for name, value in part.items() if value is not None}


async def ask(client: httpx.AsyncClient, path: str) -> httpx.Response:
    answer = await client.post(path, json={"include_embedding": True} if "class" in path else None)
    assert answer.status_code == 200
    return answer


@pytest.mark.parametrize("release", ["sealed", "raw"])
@pytest.mark.parametrize(("path", "more"), [("captures", set()), ("classifications", LABEL)])
async def test_answer_says_nothing_else(
    running: Running, bench: Bench, release: Release, path: str, more: set[str]
) -> None:
    bench.release = release
    bench.receivers.add("archive", ReceiverKey.generate().public)
    async with running() as client:
        answer = (await ask(client, f"/v1/{path}")).json()
    assert said(answer) == CLEAR | {"embedding"} | more
    assert answer["taken_at"].endswith("Z")
    assert "." not in answer["taken_at"]
    if release == "raw":
        assert said(answer["embedding"]) == OPEN
    else:
        assert said(answer["embedding"]) == SEALED
        assert said(answer["embedding"]["envelope"]) == ENVELOPE
        assert [said(each) for each in answer["embedding"]["envelope"]["keys"]] == [
            {"receiver", "key"}
        ]


async def test_without_an_embedding_no_more_than_the_label_is_said(running: Running) -> None:
    async with running() as client:
        answer = (await client.post("/v1/classifications")).json()
    assert said(answer) == CLEAR | LABEL
