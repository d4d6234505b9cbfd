"""Pieces of an event stream: events across them, and an event without an end."""

from __future__ import annotations

import gc
import json
from collections.abc import AsyncIterator, Iterator
from typing import Any

import httpx
import pytest
from tests.unit.client.conftest import Daemon, camera_of
from tests.unit.client.http.conftest import Both

from veilcam_client import Camera, EventStream
from veilcam_client.errors import ProtocolError
from veilcam_client.http.answers import MAX_EVENT

pytestmark = pytest.mark.anyio
AT = "2026-01-02T03:04:05Z"
STREAM = {"Content-Type": "text/event-stream"}


class Pieces(httpx.SyncByteStream, httpx.AsyncByteStream):
    """A body that comes in these pieces, to either kind of client."""

    def __init__(self, pieces: list[bytes]) -> None:
        self._pieces = pieces

    def __iter__(self) -> Iterator[bytes]:
        return iter(self._pieces)

    async def __aiter__(self) -> AsyncIterator[bytes]:
        for piece in self:
            yield piece


async def first_of(camera: Any) -> Any:
    stream = camera.events()
    try:
        return next(stream) if isinstance(stream, EventStream) else await anext(stream)
    finally:
        closed = stream.close()
        if closed is not None:
            await closed


def mask(epoch: str) -> str:
    return json.dumps({"kind": "mask", "id": "b-1", "at": AT, "epoch": epoch}, ensure_ascii=False)


@pytest.mark.parametrize("size", [1, 2, 7, 1000])
async def test_event_is_read_whatever_the_pieces(both: Both, size: int) -> None:
    told = mask("é\u2028z")
    text = f": comment\r\n\r\nretry: 5\nevent: mask\n\nevent: mask\r\ndata: {told}\n\n"
    content = text.encode()
    pieces = [content[start : start + size] for start in range(0, len(content), size)]
    both.daemon.first = [httpx.Response(200, stream=Pieces(pieces), headers=STREAM)]
    assert (await both(first_of)).epoch == "é\u2028z"


@pytest.mark.parametrize("piece", [b"x" * 4096, b": comment\n" * 400, b"data: 1\n" * 400])
async def test_event_without_an_end_is_refused(both: Both, piece: bytes) -> None:
    pieces = [piece] * (2 * MAX_EVENT // len(piece))
    both.daemon.first = [httpx.Response(200, stream=Pieces(pieces), headers=STREAM)]
    with pytest.raises(ProtocolError, match="an event of more than 1 MiB"):
        await both(first_of)


@pytest.mark.parametrize("short", [b"event: later\ndata: " + b"x" * 4096, b": " + b"x" * 4096])
async def test_many_short_events_are_not_one_long_one(both: Both, short: bytes) -> None:
    pieces = [short + b"\n\n"] * (2 * MAX_EVENT // 4096)
    last = f"event: mask\ndata: {mask('e1')}\n\n".encode()
    both.daemon.first = [httpx.Response(200, stream=Pieces([*pieces, last]), headers=STREAM)]
    assert (await both(first_of)).epoch == "e1"


def test_stream_that_is_let_go_of_is_closed_at_once(daemon: Daemon) -> None:
    class Body(Pieces):
        closed = False

        def close(self) -> None:
            self.closed = True

    body = Body([f"event: mask\ndata: {mask('e1')}\n\n".encode()] * 2)
    daemon.first = [httpx.Response(200, stream=body, headers=STREAM)]
    gc.disable()
    try:
        assert next(camera_of(Camera, daemon).events()).kind == "mask"
        assert body.closed
    finally:
        gc.enable()


async def test_answer_that_is_no_event_stream_is_refused(both: Both) -> None:
    both.daemon.first = [httpx.Response(200, text="<html>")]
    with pytest.raises(ProtocolError, match="no event stream"):
        await both(first_of)
