"""Attackers, in a process of their own: sockets that begin something and never finish it."""

from __future__ import annotations

import asyncio
import random
import resource
import ssl
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Literal

from tests.siege.client import ATTACKER, Address, head

Kind = Literal["silent", "headers", "body", "half handshake"]
"""What a socket does: nothing; a header or body byte by byte; or half of a TLS handshake."""
INTERVALS = (0.5, 3.0, 4.5, 9.0)
"""Times between two bytes [s], drawn for each connection: common deadlines, and just under them."""
AGAIN = 1.0
"""A socket that was dropped is opened anew after so long [s]."""
BODY = 1_000_000
"""Length that a body claims to have [bytes]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Attack:
    """So many sockets at once, for so long.

    Attributes:
        sockets: how many; they take the kinds, addresses and tokens in turn.
        seconds: as long as what is dropped is opened anew.
        lingering: as long as what is left is kept after that [s].
        tokens: for those who send a body; None for who has none.
    """

    address: Address
    sockets: int
    seconds: float
    lingering: float = 30.0
    sources: Sequence[str] = (ATTACKER,)
    kinds: Sequence[Kind] = ("headers", "body", "silent")
    tokens: Sequence[str | None] = (None,)


@dataclass
class Losses:
    """What came of an attack.

    Attributes:
        opened: connections in all.
        refused: those that did not come about.
        longest: life of a connection, from its opening until it was dropped [s].
        left: sockets that were still open in the end.
    """

    opened: int = 0
    refused: int = 0
    longest: float = 0.0
    left: int = 0
    ends: float = field(default=0.0, repr=False)


def attack(plan: Attack, tell: Connection) -> None:
    """Attack, and tell the losses in the end."""
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    tell.send(asyncio.run(_attack(plan)))


async def _attack(plan: Attack) -> Losses:
    losses = Losses(ends=time.monotonic() + plan.seconds)
    async with asyncio.TaskGroup() as group:
        for number in range(plan.sockets):
            group.create_task(_hold(plan, number, losses))
            if number % 50 == 49:
                await asyncio.sleep(0.01)
    return losses


async def _hold(plan: Attack, number: int, losses: Losses) -> None:
    """One socket, opened again whenever it is dropped."""
    while time.monotonic() < losses.ends:
        began = time.monotonic()
        try:
            dropped = await _one(plan, number, losses.ends + plan.lingering)
        except OSError:
            losses.refused += 1
        else:
            losses.opened += 1
            losses.left += not dropped
            losses.longest = max(losses.longest, time.monotonic() - began)
        await asyncio.sleep(AGAIN)


async def _one(plan: Attack, number: int, until: float) -> bool:
    """Whether one connection was dropped before ``until``; raises OSError if it was not taken."""
    kind = plan.kinds[number % len(plan.kinds)]
    source = plan.sources[number % len(plan.sources)]
    token = plan.tokens[number // len(plan.kinds) % len(plan.tokens)]
    address = plan.address.with_token(token)
    spoken = None if kind in ("silent", "half handshake") else address.tls()
    reader, writer = await asyncio.open_connection(
        address.host,
        address.port,
        ssl=spoken,
        local_addr=(source, 0),
        ssl_handshake_timeout=60.0 if spoken else None,
    )
    dribble = asyncio.create_task(_dribble(kind, address, writer))
    try:
        async with asyncio.timeout(max(0.0, until - time.monotonic())):
            # An answer drops nobody: only the end of the connection does.
            while await reader.read(4096):
                pass
    except TimeoutError:
        return False
    except OSError:
        pass
    finally:
        dribble.cancel()
        await asyncio.wait([dribble])
        writer.transport.abort()
    return True


async def _dribble(kind: Kind, address: Address, writer: asyncio.StreamWriter) -> None:
    """Write byte after byte of what never ends."""
    if kind == "silent":
        return
    if kind == "half handshake":
        writer.write(_client_hello()[:100])
        return
    path = "/v1/classifications" if kind == "body" else "/v1/status"
    method = "POST" if kind == "body" else "GET"
    length = {"Content-Type": "application/json", "Content-Length": str(BODY)}
    start = head(address, method, path, length if kind == "body" else {})
    # A body begins once its head is there; a header never ends.
    writer.write(start + b"{" if kind == "body" else start[:-2] + b"X-Slow: ")
    interval = random.choice(INTERVALS)
    with suppress(OSError):
        while True:
            await asyncio.sleep(interval)
            writer.write(b" ")
            await writer.drain()


def _client_hello() -> bytes:
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    with suppress(ssl.SSLWantReadError):
        context.wrap_bio(incoming, outgoing).do_handshake()
    return outgoing.read()
