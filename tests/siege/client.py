"""A client that sends what it is told, byte for byte: no library puts right what an attack is."""

from __future__ import annotations

import asyncio
import json
import ssl
import time
from collections import Counter
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

ATTACKER, NEIGHBOUR = "127.0.0.1", "127.0.0.2"
"""Addresses that requests come from."""
PATIENCE = 60.0
"""Longest wait for an answer [s]: a busy machine is no daemon that hangs."""


@dataclass(frozen=True, slots=True)
class Address:
    """Where a daemon is reached, and with which token.

    Attributes:
        certificate: what its TLS is checked against, a PEM file; None for plain HTTP.
        token: None for none.
    """

    host: str
    port: int
    certificate: str | None = None
    token: str | None = field(default=None, repr=False)

    def with_token(self, token: str | None) -> Address:
        """The same daemon, asked by somebody else."""
        return replace(self, token=token)

    def tls(self) -> ssl.SSLContext | None:
        """A context that knows its certificate."""
        return None if self.certificate is None else _context(self.certificate)


@cache
def _context(certificate: str) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.load_verify_locations(certificate)
    return context


@dataclass(frozen=True, slots=True)
class Reply:
    """What was answered.

    Attributes:
        status: 0 where there was no answer.
        seconds: from the first packet of the connection to the last byte.
        question: method and path.
    """

    status: int
    body: bytes = b""
    seconds: float = 0.0
    headers: Mapping[str, str] = field(default_factory=dict)
    question: str = ""

    def json(self) -> Any:
        """The body, decoded; raises :class:`ConnectionError` where there was no answer."""
        if self.status == 0:
            raise ConnectionError(f"no answer to {self.question} in {self.seconds:.1f} s")
        return json.loads(self.body)


def head(address: Address, method: str, path: str, headers: Mapping[str, str]) -> bytes:
    """Return a request up to its body, with the headers that every client sends."""
    fixed = {"Host": f"{address.host}:{address.port}", "Connection": "close"}
    if address.token is not None:
        fixed["Authorization"] = f"Bearer {address.token}"
    lines = [f"{method} {path} HTTP/1.1"]
    lines += [f"{name}: {value}" for name, value in {**fixed, **headers}.items()]
    return "\r\n".join((*lines, "", "")).encode()


async def ask(
    address: Address,
    method: str,
    path: str,
    *,
    body: bytes | object = None,
    headers: Mapping[str, str] | None = None,
    source: str = NEIGHBOUR,
    patience: float = PATIENCE,
) -> Reply:
    """Ask once over a connection of its own; who gets no answer gets the status 0.

    Args:
        address: whom.
        method: GET, POST, ...
        path: with its query.
        body: bytes as they are, anything else as JSON, None for none.
        headers: besides, or instead of, the usual ones.
        source: address that the connection comes from.
        patience: longest wait for all of it [s].
    """
    content = (
        body if isinstance(body, bytes) else b"" if body is None else json.dumps(body).encode()
    )
    given = dict(headers or {})
    if body is not None:
        given = {"Content-Type": "application/json", "Content-Length": str(len(content)), **given}
    began, received = time.monotonic(), bytearray()
    # A connection that is reset after the answer has answered.
    with suppress(OSError, TimeoutError):
        async with asyncio.timeout(patience), _connected(address, source) as (reader, writer):
            writer.write(head(address, method, path, given) + content)
            while chunk := await reader.read(65_536):
                received += chunk
    return _parse(f"{method} {path}", bytes(received), time.monotonic() - began)


@asynccontextmanager
async def _connected(
    address: Address, source: str
) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    reader, writer = await asyncio.open_connection(
        address.host, address.port, ssl=address.tls(), local_addr=(source, 0)
    )
    try:
        yield reader, writer
    finally:
        writer.transport.abort()


def _parse(question: str, received: bytes, seconds: float) -> Reply:
    start, _, body = received.partition(b"\r\n\r\n")
    first, *lines = start.decode("latin-1").split("\r\n")
    if not first.startswith("HTTP/1."):
        return Reply(0, seconds=seconds, question=question)
    pairs = (line.partition(": ") for line in lines)
    headers = {name.lower(): value for name, _, value in pairs}
    if len(body) < int(headers.get("content-length", 0)):
        return Reply(0, seconds=seconds, question=question)  # cut off
    return Reply(int(first.split()[1]), body, seconds, headers, question)


@dataclass
class EventStream:
    """What came over one event stream so far.

    Attributes:
        status: of the answer, 0 before there is one.
        kinds: how many events of each kind.
        masks: names of the epochs that it told of.
        ended: whether the daemon closed it.
    """

    status: int = 0
    kinds: Counter[str] = field(default_factory=Counter)
    masks: list[str] = field(default_factory=list)
    ended: bool = False

    async def until(self, kind: str, count: int, patience: float = PATIENCE) -> bool:
        """Whether so many events of a kind come within ``patience`` [s]."""
        with suppress(TimeoutError):
            async with asyncio.timeout(patience):
                while self.kinds[kind] < count and not self.ended:
                    await asyncio.sleep(0.02)
        return self.kinds[kind] >= count

    def _take(self, line: bytes) -> None:
        name, _, value = line.decode().strip().partition(": ")
        if name == "event":
            self.kinds[value] += 1
        elif name == "data" and '"kind":"mask"' in value:
            self.masks.append(json.loads(value)["epoch"])


@asynccontextmanager
async def listening(address: Address, source: str = NEIGHBOUR) -> AsyncIterator[EventStream]:
    """Yield an event stream that was answered, or refused, and is read as long as the context."""
    stream, answered = EventStream(), asyncio.Event()

    async def read() -> None:
        try:
            async with _connected(address, source) as (reader, writer):
                writer.write(head(address, "GET", "/v1/events", {}))
                first = await reader.readline()
                stream.status = int(first.split()[1]) if first else 0
                answered.set()
                async for line in reader:
                    stream._take(line)
        except (OSError, ValueError):
            pass
        finally:
            stream.ended = True
            answered.set()

    task = asyncio.create_task(read())
    try:
        with suppress(TimeoutError):
            async with asyncio.timeout(PATIENCE):
                await answered.wait()
        yield stream
    finally:
        task.cancel()
        await asyncio.wait([task])
