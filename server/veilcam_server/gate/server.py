"""Server of uvicorn, with accept loops that let peers in by turns."""

from __future__ import annotations

import asyncio
import socket
from collections import deque
from errno import EMFILE, ENFILE

import structlog
import uvicorn

from veilcam_server.gate.protocol import Connections, GateProtocol
from veilcam_server.system.listeners import BACKLOG, peer_of
from veilcam_server.system.logs import Throttle

BATCH = 64  # connections that are taken from the kernel at a time
PAUSE = 0.02  # after a connection that could not be accepted [s]

log = structlog.get_logger()


class GateServer(uvicorn.Server):
    """uvicorn's server behind the gate.

    The kernel has one queue for all peers. Accepted sockets wait here in a queue for each peer: the
    peer with fewest connections comes first, and peers with as many take turns.

    Args:
        config: configuration of uvicorn. Its ``ssl`` holds for every socket.
        connections: connections that are let in.
    """

    def __init__(self, config: uvicorn.Config, connections: Connections) -> None:
        super().__init__(config)
        self._connections = connections
        self._listeners: list[socket.socket] = []
        self._queues: dict[str, deque[socket.socket]] = {}
        self._failed = Throttle()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start the application, then accept connections of ``sockets``."""
        await super().startup([])  # uvicorn makes no accept loop of an empty list
        self._listeners = sockets or []
        for listener in self._listeners:
            listener.setblocking(False)
            listener.listen(BACKLOG)
            self._listen(listener)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Accept nothing more, end connections that do not work, and wait for the others."""
        for listener in self._listeners:
            asyncio.get_running_loop().remove_reader(listener)
        self._listeners = []
        while self._queues:
            self._drop_waiting()
        self._connections.end_all_but_working()
        await super().shutdown(sockets)

    def _listen(self, listener: socket.socket) -> None:
        if listener in self._listeners:
            asyncio.get_running_loop().add_reader(listener, self._accept, listener)

    def _accept(self, listener: socket.socket) -> None:
        for _ in range(BATCH):
            try:
                accepted, address = listener.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                break
            except OSError as error:
                self._recover(listener, error)
                break
            accepted.setblocking(False)
            if not self._queues:
                asyncio.get_running_loop().call_soon(self._let_in)
            self._queues.setdefault(peer_of(address), deque()).append(accepted)
            if sum(map(len, self._queues.values())) > self._connections.waiting:
                self._drop_waiting()
                self._connections.dropped["evicted"] += 1

    def _recover(self, listener: socket.socket, error: OSError) -> None:
        """Make room for a connection that could not be accepted, and try again after a pause."""
        self._connections.failures += 1
        if (count := self._failed.due()) is not None:
            log.warning("connection not accepted", error=error.strerror, times=count)
        if error.errno in (EMFILE, ENFILE) and not self._connections.make_room() and self._queues:
            self._drop_waiting()
        loop = asyncio.get_running_loop()
        loop.remove_reader(listener)
        loop.call_later(PAUSE, self._listen, listener)

    def _drop_waiting(self) -> None:
        """Close the oldest socket of the peer with most that wait."""
        self._take(max(self._queues, key=lambda peer: len(self._queues[peer]))).close()

    def _take(self, peer: str) -> socket.socket:
        """Return the oldest waiting socket of a peer, whose next turn is after all others'."""
        queue = self._queues.pop(peer)
        if len(queue) > 1:
            self._queues[peer] = queue
        return queue.popleft()

    def _let_in(self) -> None:
        """Let one socket in. Open connections have their turn before the next."""
        if not self._queues:
            return
        peer = min(self._queues, key=self._connections.of.__getitem__)
        accepted, given = self._take(peer), (self.config, self.server_state, self.lifespan.state)
        new = GateProtocol(*given, connections=self._connections, peer=peer)
        if self._connections.enter(new):
            new.beginning = asyncio.create_task(self._begin(accepted, new))
        else:
            accepted.close()
        if self._queues:
            asyncio.get_running_loop().call_soon(self._let_in)

    async def _begin(self, accepted: socket.socket, connection: GateProtocol) -> None:
        """Connect a socket with its protocol, after the TLS handshake where there is one."""
        tls, limit = self.config.ssl, self._connections.headers
        try:
            await asyncio.get_running_loop().connect_accepted_socket(
                lambda: connection, accepted, ssl=tls, ssl_handshake_timeout=limit if tls else None
            )
        except OSError:  # a handshake that failed; asyncio has closed the socket
            self._connections.drop(connection, "handshake")
        finally:
            connection.beginning = None  # it refers to its connection
