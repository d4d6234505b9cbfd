"""Accept loop of the listening sockets: who waits to come in, and whose turn it is."""

from __future__ import annotations

import asyncio
import errno
import socket
import ssl
from collections import OrderedDict, deque
from collections.abc import Callable, Sequence

import structlog

from veilcam_server.gate.connections import Connection, Connections, peer_of
from veilcam_server.system.logs import Throttle

log = structlog.get_logger()

BACKLOG = 2048
"""Connections that the kernel keeps for us. One that it drops is tried again after a second."""
BATCH = 64
"""Connections that are taken from the kernel at a time."""
PAUSE = 0.02
"""After a connection that could not be accepted [s]."""
GOODBYE = 5.0
"""What the other side has to answer the end of TLS [s]."""


class WaitingRoom:
    """Accepted sockets that nothing was spent on yet.

    The kernel keeps one queue for all: behind a thousand connections of one peer, everybody waits.
    Here each peer has a queue of its own, and who has fewest connections comes in first; those with
    as many take turns.

    Args:
        capacity: sockets in all. For one more, the peer with most of them loses its oldest.
        connections_of: greatest number of connections of a peer.
    """

    def __init__(self, capacity: int, connections_of: Callable[[str], int]) -> None:
        self._capacity, self._connections_of = capacity, connections_of
        self._queues: OrderedDict[str, deque[socket.socket]] = OrderedDict()
        self._waiting = 0

    def __len__(self) -> int:
        return self._waiting

    def put(self, peer: str, accepted: socket.socket) -> bool:
        """Let one wait; False if another one had to go for it."""
        self._queues.setdefault(peer, deque()).append(accepted)
        self._waiting += 1
        if self._waiting <= self._capacity:
            return True
        self.drop()
        return False

    def drop(self) -> bool:
        """Close the oldest of the peer with most; False if nobody waits."""
        if not self._waiting:
            return False
        peer = max(self._queues, key=lambda name: len(self._queues[name]))
        self._first_of(peer).close()
        return True

    def take(self) -> tuple[str, socket.socket]:
        """Return whose turn it is, and the oldest of that peer."""
        peer = min(self._queues, key=self._connections_of)
        accepted = self._first_of(peer)
        if peer in self._queues:
            self._queues.move_to_end(peer)
        return peer, accepted

    def _first_of(self, peer: str) -> socket.socket:
        first = self._queues[peer].popleft()
        self._waiting -= 1
        if not self._queues[peer]:
            del self._queues[peer]
        return first


class Entrance:
    """Lets connections of listening sockets in.

    Args:
        listeners: listening sockets.
        connections: connections of the whole daemon.
        protocol: makes what serves a connection.
        tls: None without it.
        handshake: longest time that TLS may take to begin [s].
        waiting: accepted sockets that may wait.
    """

    def __init__(
        self,
        listeners: Sequence[socket.socket],
        connections: Connections,
        protocol: Callable[[Connection], asyncio.Protocol],
        *,
        tls: ssl.SSLContext | None,
        handshake: float,
        waiting: int,
    ) -> None:
        self._listeners, self._connections, self._protocol = listeners, connections, protocol
        self._tls, self._handshake = tls, handshake
        self._waiting = WaitingRoom(waiting, connections.of)
        self._loop = asyncio.get_running_loop()
        self._next: asyncio.Handle | None = None
        self._beginning: set[asyncio.Task[None]] = set()
        self._failed = Throttle()
        self._open = False

    def open(self) -> None:
        """Accept connections from now on."""
        self._open = True
        for listener in self._listeners:
            listener.setblocking(False)
            listener.listen(BACKLOG)
            self._listen(listener)

    def close(self) -> None:
        """Accept no more, and send away who waits."""
        self._open = False
        for listener in self._listeners:
            self._loop.remove_reader(listener)
        if self._next is not None:
            self._next.cancel()
        while self._waiting.drop():
            pass

    def _listen(self, listener: socket.socket) -> None:
        if self._open:
            self._loop.add_reader(listener, self._accept, listener)

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
            if not self._waiting.put(peer_of(address), accepted):
                self._connections.dropped["evicted"] += 1
        if self._next is None:
            self._let_in()

    def _recover(self, listener: socket.socket, error: OSError) -> None:
        self._connections.failures += 1
        if (count := self._failed.due()) is not None:
            log.warning("connection not accepted", error=error.strerror, times=count)
        # Who waits goes last: this comes up also where nobody else is at the door.
        if error.errno in (errno.EMFILE, errno.ENFILE) and not self._connections.make_room():
            self._waiting.drop()
        # The socket stays readable: without a pause this would be a busy loop.
        self._loop.remove_reader(listener)
        self._loop.call_later(PAUSE, self._listen, listener)

    def _let_in(self) -> None:
        """Let one in.

        Before the next, those inside have their turn. An answer takes several turns, and these must
        not become longer the more there are at the door.
        """
        self._next = None
        if not self._waiting:
            return
        peer, accepted = self._waiting.take()
        connection = self._connections.enter(peer)
        if connection is None:
            accepted.close()
        else:
            self._begin(accepted, connection)
        if self._waiting:
            self._next = self._loop.call_soon(self._let_in)

    def _begin(self, accepted: socket.socket, connection: Connection) -> None:
        task = self._loop.create_task(self._connect(accepted, connection))
        connection.abort = task.cancel
        self._beginning.add(task)

        def begun(task: asyncio.Task[None]) -> None:
            self._beginning.discard(task)
            if task.cancelled():
                accepted.close()

        task.add_done_callback(begun)

    async def _connect(self, accepted: socket.socket, connection: Connection) -> None:
        """Make a protocol of the socket; with TLS, that takes as long as the other side likes."""
        try:
            await self._loop.connect_accepted_socket(
                lambda: self._protocol(connection),
                accepted,
                ssl=self._tls,
                ssl_handshake_timeout=None if self._tls is None else self._handshake,
                ssl_shutdown_timeout=None if self._tls is None else GOODBYE,
            )
        except OSError:
            # TLS that is none, or took too long. asyncio has closed the socket.
            connection.drop("handshake")
