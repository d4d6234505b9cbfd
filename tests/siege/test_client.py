"""The client of a siege: what it sends, and what it makes of answers that are late, cut or odd."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

import pytest
from tests.siege.client import NEIGHBOUR, Address, ask, listening

pytestmark = pytest.mark.anyio

Handle = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


@asynccontextmanager
async def serving(handle: Handle) -> AsyncIterator[Address]:
    server = await asyncio.start_server(handle, "127.0.0.1", 0)
    async with server:
        yield Address("127.0.0.1", server.sockets[0].getsockname()[1], token="secret")


def answering(*chunks: bytes, heard: list[bytes] | None = None) -> Handle:
    """Answer with ``chunks`` and close."""

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        request = await reader.readuntil(b"\r\n\r\n")
        if heard is not None:
            heard.extend((request, writer.get_extra_info("peername")[0].encode()))
        for chunk in chunks:
            writer.write(chunk)
            await writer.drain()
        writer.close()

    return handle


async def test_a_request_is_sent_as_it_was_told() -> None:
    heard: list[bytes] = []
    async with serving(answering(b"HTTP/1.1 200 OK\r\n\r\n", heard=heard)) as address:
        headers = {"Host": "evil.example", "X-Own": "1"}
        await ask(address, "PUT", "/v1/rotation", body={"mode": "off"}, headers=headers)
    head, peer = heard
    lines = head.decode().split("\r\n")
    assert lines[0] == "PUT /v1/rotation HTTP/1.1"
    assert {"Host: evil.example", "X-Own: 1", "Authorization: Bearer secret"} <= set(lines)
    assert {"Content-Type: application/json", "Content-Length: 15"} <= set(lines)
    assert peer.decode() == NEIGHBOUR


async def test_an_answer_is_read_to_its_end() -> None:
    chunks = (b"HTTP/1.1 404 Not Found\r\nX-Own: 2\r\n\r\n{", b'"code": "unknown"}')
    async with serving(answering(*chunks)) as address:
        reply = await ask(address, "GET", "/")
    assert (reply.status, reply.json(), reply.headers) == (404, {"code": "unknown"}, {"x-own": "2"})


@pytest.mark.parametrize(
    "chunk",
    [b"", b"nonsense\r\n\r\n", b"HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\ncut "],
)
async def test_what_is_no_answer_has_the_status_0(chunk: bytes) -> None:
    async with serving(answering(chunk)) as address:
        assert (await ask(address, "GET", "/")).status == 0


async def test_nobody_there_and_nobody_speaking_have_the_status_0() -> None:
    async def silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read()
        writer.close()

    async with serving(silent) as address:
        reply = await ask(address, "GET", "/", patience=0.1)
        assert (reply.status, reply.seconds >= 0.1) == (0, True)
    assert (await ask(address, "GET", "/")).status == 0


async def test_events_are_counted_and_masks_named() -> None:
    told = (
        b"HTTP/1.1 200 OK\r\n\r\n",
        b'event: mask\r\ndata: {"kind":"mask","epoch":"a1"}\r\n\r\n',
        b"event: capture\r\n\r\n: heartbeat\r\n",
    )
    async with serving(answering(*told)) as address, listening(address) as stream:
        assert stream.status == 200
        assert await stream.until("capture", 1)
        assert not await stream.until("mask", 2, 0.2)
    assert (dict(stream.kinds), stream.masks, stream.ended) == (
        {"mask": 1, "capture": 1},
        ["a1"],
        True,
    )


async def test_a_stream_that_is_refused_tells_nothing() -> None:
    async with (
        serving(answering(b"HTTP/1.1 429 Too Many\r\n\r\n")) as address,
        listening(address) as stream,
    ):
        assert stream.status == 429
        assert not await stream.until("mask", 1)
