"""HTTP/1.1 of uvicorn with a cap of connections, deadlines, and eviction by peer."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from contextlib import suppress
from typing import Any, Literal, TypeAlias, cast

import h11
import structlog
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from veilcam_client.wire.base import RUN_HEADER
from veilcam_server.security.site import call_header, security_headers
from veilcam_server.system.logs import Throttle

PORTION = 16 * 1024
"""Part of a body that each of its deadlines asks for [bytes]. A request is handed on with its first
portion, or its whole body, so that the application sees nothing of a peer that dribbles."""
UPLOAD_PAUSE = 2.0
"""Longest wait for the first portion of an upload [s]; then its headers are handed on alone."""
READING_TIME = 30.0
"""Longest time in which a peer reads nothing of an answer [s]."""

Place: TypeAlias = Literal["unfinished", "idle", "working"]
"""State of a connection: before its request is handed on, after its answer, or between the two."""
Reason: TypeAlias = Literal["evicted", "refused", "handshake", "headers", "body", "answer"]
"""Reason of an end by the gate: no room, or the step that missed its deadline."""

log = structlog.get_logger()
_quiet = logging.getLogger("veilcam_server.gate.uvicorn")
_quiet.setLevel(logging.ERROR)  # bytes that are no HTTP get no line: a peer sends them without end


class Connections:
    """Open connections of one daemon, and their limits.

    Where none is free, a new connection takes the place of another one. The peer with most
    connections that do not work loses its oldest unfinished one, or else its oldest idle one.
    So a peer evicts its own connections first, and connections that work stay.

    Args:
        limit: greatest number of connections.
        waiting: greatest number of accepted sockets that wait to become connections.
        headers: longest time for a TLS handshake, and for the headers of a request [s].
        body: longest time for each :data:`PORTION` of a body [s].
        run: name of this run of the daemon.
    """

    def __init__(
        self, limit: int, waiting: int, headers: float = 10.0, body: float = 20.0, run: str = ""
    ) -> None:
        self.limit, self.waiting, self.headers, self.body = limit, waiting, headers, body
        self.run = run
        self.dropped: Counter[Reason] = Counter()
        """Connections that the gate ended, by reason."""
        self.failures = 0
        """Connections that could not be accepted."""
        self.of: Counter[str] = Counter()
        """Connections by peer."""
        self._evictable: Counter[str] = Counter()
        self._places: dict[GateProtocol, Place] = {}  # the last to move is the last
        self._full = Throttle()

    def __len__(self) -> int:
        return len(self._places)

    def enter(self, connection: GateProtocol) -> bool:
        """Count a new connection as unfinished; return False if there is no room for it."""
        if len(self) >= self.limit and not self.make_room():
            self.dropped["refused"] += 1
            return False
        self._put(connection, "unfinished", 1)
        return True

    def move(self, connection: GateProtocol, place: Place) -> None:
        """Count a connection elsewhere, as the youngest there. One that left stays out."""
        if self._places.get(connection, place) != place and self.leave(connection):
            self._put(connection, place, 1)

    def leave(self, connection: GateProtocol) -> bool:
        """Stop counting a connection; return False if it was not counted."""
        if (place := self._places.get(connection)) is not None:
            self._put(connection, place, -1)
            del self._places[connection]
        return place is not None

    def drop(self, connection: GateProtocol, *reason: Reason) -> None:
        """End a connection, and count the reason."""
        if self.leave(connection):
            self.dropped.update(reason)
            connection.abort()

    def make_room(self) -> bool:
        """Evict a connection; return False if there is none to evict."""
        most = max(self._evictable.values(), default=0)
        evictable = (
            each
            for place in ("unfinished", "idle")
            for each, present in self._places.items()
            if present == place and self._evictable[each.peer] == most
        )
        victim = next(evictable, None)
        if (count := self._full.due()) is not None:
            log.warning(
                "connections full", limit=self.limit, times=count, peer=victim and victim.peer
            )
        if victim:
            self.drop(victim, "evicted")
        return victim is not None

    def end_all_but_working(self) -> None:
        """End every connection that does not work."""
        for connection, place in tuple(self._places.items()):
            if place != "working":
                self.drop(connection)

    def _put(self, connection: GateProtocol, place: Place, number: int) -> None:
        self._places[connection] = place
        for counter in (self.of, self._evictable)[: 1 if place == "working" else 2]:
            counter[connection.peer] += number
            if not counter[connection.peer]:
                del counter[connection.peer]


class GateProtocol(H11Protocol):
    """One HTTP connection, which ends where it is too slow or makes room.

    Args:
        given: configuration, server state and application state, as uvicorn gives them.
        connections: connections that this one is counted among.
        peer: name of the other side.
    """

    def __init__(self, *given: Any, connections: Connections, peer: str) -> None:
        super().__init__(*given)
        self.logger = _quiet
        self.gate, self.peer = connections, peer
        self.beginning: asyncio.Task[None] | None = None
        """Task that connects it, TLS handshake included."""
        self._application, self.app = cast(ASGIApp, self.app), cast(Any, self._hand_on)
        self._stage: tuple[object, Place, Reason | None] | None = None
        self._received, self._begun = 0, asyncio.Event()
        self._deadline: asyncio.TimerHandle | None = None

    def abort(self) -> None:
        """End it at once."""
        (self.transport.abort if self.beginning is None else self.beginning.cancel)()

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for headers."""
        super().connection_made(transport)
        self.beginning = None
        self._settle()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait for nothing more."""
        self.gate.leave(self)
        self._wait(None)
        self._unset_keepalive_if_required()
        super().connection_lost(exc)
        self._begun.set()
        self.app = cast(Any, self._application)  # ends a circle of references, and so its memory

    def data_received(self, data: bytes) -> None:
        """Take in data."""
        self._received += len(data)
        super().data_received(data)

    def handle_events(self) -> None:
        """Go on with the request."""
        before = self.cycle
        super().handle_events()
        if self.cycle is not before:
            self._begun = asyncio.Event()
        if self.cycle and (len(self.cycle.body) >= PORTION or not self.cycle.more_body):
            self._begun.set()
        self._settle()

    def on_response_complete(self) -> None:
        """Go on to the next request."""
        super().on_response_complete()
        self._settle()

    def pause_writing(self) -> None:
        """Give the reader of the answer a deadline."""
        super().pause_writing()
        self._settle()

    def resume_writing(self) -> None:
        """Go on: the answer is read."""
        super().resume_writing()
        self._settle()

    def send_400_response(self, msg: str) -> None:
        """Refuse what is no HTTP, and close the connection."""
        headers = {"Content-Type": "text/plain", "Connection": "close", **security_headers(())}
        headers[RUN_HEADER] = self.gate.run
        if self.conn.our_state is h11.SEND_RESPONSE:  # the body is at fault, not the headers
            headers |= call_header(Headers(raw=self.headers))
        if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE):
            answer = h11.Response(status_code=400, headers=[*headers.items()], reason="Bad Request")
            for event in (answer, h11.Data(data=msg.encode()), h11.EndOfMessage()):
                self.transport.write(self.conn.send(event) or b"")
        self.transport.close()
        self._settle()

    def _settle(self) -> None:
        """Take the place, and begin the deadline, of the present stage by h11's account."""
        theirs, answered = self.conn.their_state, self.transport.is_closing()
        answered = answered or not self.cycle or self.cycle.response_complete
        stage: tuple[Place, Reason | None] = "working", None
        if theirs is h11.IDLE and (not self.cycle or self.conn.trailing_data[0]):
            stage = "unfinished", "headers"
        elif theirs is h11.SEND_BODY:
            stage = "unfinished" if answered or not self._begun.is_set() else "working", "body"
        elif answered:  # uvicorn ends an idle connection sooner, but not before it is read
            stage = "idle", "answer"
        place, reason = stage[0], "answer" if self.flow.write_paused else stage[1]
        if self._stage != (self.cycle, place, reason):
            self._stage = (self.cycle, place, reason)
            self.gate.move(self, place)
            self._wait(reason)

    def _wait(self, reason: Reason | None) -> None:
        """Begin a deadline, instead of the one before."""
        if self._deadline is not None:
            self._deadline.cancel()
        due = self._received + PORTION

        def end(reason: Reason) -> None:
            # The other side cannot send while the application does not read.
            if reason == "body" and (self._received >= due or self.flow.read_paused):
                self._wait(reason)
            else:
                self.gate.drop(self, reason)

        times = {"headers": self.gate.headers, "body": self.gate.body, "answer": READING_TIME}
        if reason is not None:
            self._deadline = self.loop.call_later(times[reason], end, reason)

    async def _hand_on(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand a request on with the first portion of its body.

        The headers of an upload that pauses are handed on alone, so that they can be refused.
        """
        cycle, begun, headers = self.cycle, self._begun, Headers(scope=scope)
        if "content-length" in headers and "transfer-encoding" in headers:
            # A proxy in front may see another end of this body (RFC 9112, 6.3).
            self.send_400_response("Content-Length and Transfer-Encoding: send one of them.")
            cycle.disconnected = True  # so that uvicorn sends no answer of its own
        elif not cycle.waiting_for_100_continue:
            chunked, size = "transfer-encoding" in headers, int(headers.get("content-length", 0))
            with suppress(TimeoutError):
                async with asyncio.timeout(UPLOAD_PAUSE if chunked or size > PORTION else None):
                    await begun.wait()
        if cycle.disconnected:
            return

        async def receive_portion() -> Message:
            if cycle.waiting_for_100_continue and not cycle.disconnected:
                begun.set()
                self._settle()
            await begun.wait()
            return await receive()

        async def send_or_close(message: Message) -> None:
            if message["type"] == "http.response.start" and cycle.waiting_for_100_continue:
                # The other side may send the body all the same.
                message = {**message, "headers": [*message["headers"], (b"connection", b"close")]}
            await send(message)

        await self._application(scope, receive_portion, send_or_close)
