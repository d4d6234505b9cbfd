"""Server behind the gate, a clock that can be put on, and clients."""

from __future__ import annotations

import asyncio
import socket
import ssl
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, ExitStack, asynccontextmanager
from dataclasses import dataclass, field
from typing import TypeAlias

import pytest
import uvicorn
from starlette.types import Message, Receive, Scope, Send

from veilcam_server.gate.protocol import Connections
from veilcam_server.gate.server import GateServer

PATIENCE = 600.0
"""Deadline that no test comes to [s]."""
ENOUGH = 30.0
"""What is awaited happens long before [s]."""
REQUEST = b"GET / HTTP/1.1\r\nHost: a\r\n\r\n"
POST = b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: %d\r\n\r\n"
SLOW = b"GET /slow HTTP/1.1\r\nHost: a\r\n\r\n"


@dataclass
class Behind:
    """What stands behind the gate, and what it was asked."""

    connections: Connections
    server: GateServer
    address: tuple[str, int]
    asked: list[str] = field(default_factory=list)
    bodies: list[int] = field(default_factory=list)
    """How much was read of each."""
    go: asyncio.Event = field(default_factory=asyncio.Event)
    """Lets slow requests end."""
    passed: float = 0.0
    """By how much the loop's clock was put on [s]."""
    clients: ExitStack = field(default_factory=ExitStack)

    def knock(self, said: bytes = b"", source: str = "127.0.0.1") -> socket.socket:
        """Return a client's socket, bound to an address of loopback, that has sent something."""
        one = self.clients.enter_context(socket.socket())
        one.bind((source, 0))
        one.connect(self.address)
        one.setblocking(False)
        one.sendall(said)
        return one

    async def app(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Read the body and answer; ``/deaf`` does not read it, and ``/late`` does so later."""
        path = scope["path"]
        self.asked.append(path)
        answer, more = b"x" * 2**24 if path == "/big" else b"ok", path != "/deaf"
        if more:
            self.bodies.append(0)
        if path == "/late":
            await self.go.wait()
        while more:
            message: Message = await receive()
            if message["type"] == "http.disconnect":
                return
            self.bodies[-1] += len(message["body"])
            more = message["more_body"]
        if path == "/slow":
            await self.go.wait()
        await send({"type": "http.response.start", "status": 200, "headers": _length(answer)})
        await send({"type": "http.response.body", "body": answer})

    async def let_pass(self, seconds: float) -> None:
        """Put the clock on: a deadline is no matter of how busy a machine is.

        Whatever was sent before is read before; what is due then has happened at the end.
        """
        await _turns()
        self.passed += seconds
        await _turns()

    async def until(self, condition: Callable[[], object]) -> None:
        async with asyncio.timeout(ENOUGH):
            while not condition():
                await asyncio.sleep(0.001)


async def _turns() -> None:
    """Let the loop go round: what a socket holds is read within a few of its turns."""
    for _ in range(100):
        await asyncio.sleep(0)


def _length(answer: bytes) -> list[tuple[bytes, bytes]]:
    return [(b"content-length", str(len(answer)).encode())]


Serving: TypeAlias = Callable[..., AbstractAsyncContextManager[Behind]]


@pytest.fixture
def serving(monkeypatch: pytest.MonkeyPatch) -> Serving:
    @asynccontextmanager
    async def serve(
        *,
        limit: int = 8,
        waiting: int = 64,
        headers: float = PATIENCE,
        body: float = PATIENCE,
        tls: ssl.SSLContext | None = None,
        listening: type[socket.socket] = socket.socket,
    ) -> AsyncIterator[Behind]:
        async def app(scope: Scope, receive: Receive, send: Send) -> None:
            await behind.app(scope, receive, send)

        config = uvicorn.Config(
            app,
            http="h11",
            ws="none",
            lifespan="off",
            log_config=None,
            ssl_context_factory=None if tls is None else lambda *_: tls,
            timeout_keep_alive=10_000,
        )
        connections = Connections(limit, waiting, headers, body, run="the-run")
        server = GateServer(config, connections)
        with listening() as listener:
            listener.bind(("127.0.0.1", 0))
            behind = Behind(connections, server, listener.getsockname())
            loop = asyncio.get_running_loop()
            monkeypatch.setattr(loop, "time", lambda now=loop.time: now() + behind.passed)
            serving = asyncio.create_task(server.serve([listener]))
            try:
                await behind.until(lambda: server.started or serving.done())
                yield behind
            finally:
                server.should_exit = True
                behind.go.set()
                await serving
                behind.clients.close()

    return serve


async def heard(one: socket.socket) -> bytes:
    """What comes next; nothing if the other side has ended it."""
    try:
        async with asyncio.timeout(ENOUGH):
            return await asyncio.get_running_loop().sock_recv(one, 2**16)
    except ConnectionError:
        return b""


async def is_served(one: socket.socket) -> bool:
    """Whether the answer, which comes in as many pieces as it likes, is that all went well."""
    answer = b""
    while not answer.endswith(b"\r\n\r\nok") and (piece := await heard(one)):
        answer += piece
    return answer.startswith(b"HTTP/1.1 200")
