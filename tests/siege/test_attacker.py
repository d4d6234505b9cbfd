"""Attackers against servers that hold everything, and servers that drop everything."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
from tests.siege import attacker
from tests.siege.attacker import Attack, Losses
from tests.siege.client import Address

pytestmark = pytest.mark.anyio


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attacker, "AGAIN", 0.02)
    monkeypatch.setattr(attacker, "INTERVALS", (0.02,))


@asynccontextmanager
async def serving(received: dict[int, bytes], patience: float) -> AsyncIterator[Address]:
    """A server that drops a connection after ``patience`` [s]."""

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        number, taken = len(received), b""
        received[number] = b""
        try:
            async with asyncio.timeout(patience):
                while chunk := await reader.read(4096):
                    taken += chunk
        except (TimeoutError, ConnectionError):
            pass
        finally:
            received[number] = taken
            writer.close()

    server = await asyncio.start_server(handle, "127.0.0.1", 0)
    async with server:
        yield Address("127.0.0.1", server.sockets[0].getsockname()[1])


async def attack(address: Address, **more: object) -> Losses:
    plan = Attack(address=address, sockets=6, seconds=0.3, lingering=0.5, **more)  # type: ignore[arg-type]
    return await attacker._attack(plan)


async def test_what_is_not_dropped_is_left() -> None:
    async with serving({}, 10.0) as address:
        losses = await attack(address)
    assert (losses.opened, losses.left) == (6, 6)
    assert losses.longest >= 0.8


async def test_what_is_dropped_comes_again() -> None:
    async with serving({}, 0.05) as address:
        losses = await attack(address)
    assert losses.opened > 6
    assert losses.left == 0
    assert losses.longest < 0.8


async def test_where_nobody_listens_connections_are_refused() -> None:
    with socket.socket() as deaf:  # bound, and nothing listens
        deaf.bind(("127.0.0.1", 0))
        losses = await attack(Address("127.0.0.1", deaf.getsockname()[1]))
    assert losses.opened == 0
    assert losses.refused >= 6


async def test_nothing_is_ever_whole() -> None:
    received: dict[int, bytes] = {}
    async with serving(received, 0.2) as address:
        await attack(address, tokens=(None, "secret"))
    headers = [each for each in received.values() if each.startswith(b"GET /v1/status")]
    bodies = [each for each in received.values() if each.startswith(b"POST ")]
    silent = [each for each in received.values() if not each]
    assert headers
    assert bodies
    assert silent
    assert not any(b"\r\n\r\n" in each for each in headers)
    assert max(len(each.partition(b"\r\n\r\n")[2]) for each in bodies) in range(2, 100)
    assert {b"Bearer secret" in each for each in bodies} == {True, False}


async def test_half_a_handshake_is_no_whole_one() -> None:
    received: dict[int, bytes] = {}
    async with serving(received, 0.1) as address:
        await attack(address, kinds=("half handshake",))
    hello = received[0]
    assert hello.startswith(b"\x16\x03")
    assert len(hello) == 100 < len(attacker._client_hello())
