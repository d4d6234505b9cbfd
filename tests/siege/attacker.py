"""Attackers, in a process of their own: sockets that begin something and never finish it."""

from __future__ import annotations

import asyncio
import random
import resource
import ssl
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Literal
from urllib.parse import urlsplit

from tests.siege.client import ATTACKER, Address

Kind = Literal["silent", "headers", "body", "half handshake"]
"""Habit of a socket: nothing, a header or body byte by byte, or half of a TLS handshake."""
INTERVALS = (0.5, 3.0, 4.5, 9.0)
"""Times between two bytes [s], drawn for each connection: common deadlines, and just under them."""
AGAIN = 1.0  # [s]
BODY = 1_000_000  # [bytes]


@dataclass(frozen=True, slots=True, kw_only=True)
class Attack:
    """Sockets that are held open at once."""

    address: Address
    sockets: int
    seconds: float
    lingering: float = 30.0
    sources: Sequence[str] = (ATTACKER,)
    kinds: Sequence[Kind] = ("headers", "body", "silent")
    tokens: Sequence[str | None] = (None,)

    async def run(self) -> Losses:
        losses, ends = Losses(), time.monotonic() + self.seconds
        async with asyncio.TaskGroup() as group:
            for number in range(self.sockets):
                group.create_task(self._hold(number, losses, ends))
                if number % 50 == 49:
                    await asyncio.sleep(0.01)
        return losses

    async def _hold(self, number: int, losses: Losses, ends: float) -> None:
        while time.monotonic() < ends:
            began = time.monotonic()
            try:
                dropped = await self._one(number, ends + self.lingering)
            except OSError:
                losses.refused += 1
            else:
                losses.opened += 1
                losses.left += not dropped
                losses.longest = max(losses.longest, time.monotonic() - began)
            await asyncio.sleep(AGAIN)

    async def _one(self, number: int, until: float) -> bool:
        kind = self.kinds[number % len(self.kinds)]
        token = self.tokens[number // len(self.kinds) % len(self.tokens)]
        address, place = self.address.with_token(token), urlsplit(self.address.url)
        spoken = place.scheme == "https" and kind not in ("silent", "half handshake")
        reader, writer = await asyncio.open_connection(
            *(place.hostname, place.port),
            ssl=address.context() if spoken else None,
            local_addr=(self.sources[number % len(self.sources)], 0),
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


@dataclass
class Losses:
    """Connections of an attack: opened and refused, longest life [s], and left open in the end."""

    opened: int = 0
    refused: int = 0
    longest: float = 0.0
    left: int = 0


def attack(tell: Connection, plan: Attack) -> None:
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    tell.send(asyncio.run(plan.run()))


def head(address: Address, method: str, path: str, **headers: object) -> bytes:
    told = {"Host": urlsplit(address.url).netloc, **address.headers}
    told |= {name.replace("_", "-"): str(value) for name, value in headers.items()}
    lines = (f"{method} {path} HTTP/1.1", *(f"{name}: {told[name]}" for name in told), "", "")
    return "\r\n".join(lines).encode()


async def _dribble(kind: Kind, address: Address, writer: asyncio.StreamWriter) -> None:
    if kind == "silent":
        return
    if kind == "half handshake":
        writer.write(_client_hello()[:100])
        return
    if kind == "body":  # it begins once its head is there
        claims = {"Content_Type": "application/json", "Content_Length": BODY}
        writer.write(head(address, "POST", "/v1/classifications", **claims) + b"{")
    else:
        writer.write(head(address, "GET", "/v1/status")[:-2] + b"X-Slow: ")
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
