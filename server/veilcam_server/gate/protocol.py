"""HTTP/1.1 of uvicorn, with deadlines for whoever sends or reads too slowly."""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any, cast

import h11
import uvicorn
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState

from veilcam_client.wire.base import CALL_HEADER
from veilcam_server.gate.connections import Connection, Place, Reason

PORTION = 16 * 1024
"""A request is handed on when so much of its body is there, or all of it [bytes]. So whoever
dribbles is seen by nobody behind the gate: nothing is counted, allocated or logged for it. This is
also what a body has to bring on within each of its deadlines."""
UPLOAD_PAUSE = 2.0
"""The gate waits so long for the first portion of a large body [s]. Then it hands on the headers
alone. The socket of an attack is dropped before that, so it costs no answer."""
READING_TIME = 30.0
"""An answer that does not move for so long is not read by anybody [s]."""

FOR_BROWSERS = {
    "Content-Security-Policy": (
        "default-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""What the application says with each of its answers; here stands what it never hears of."""

_CALL = re.compile(r"[0-9A-Fa-f]{32}")

# Whoever sends what is no HTTP may do so without end: that is worth no line.
_quiet = logging.getLogger("veilcam_server.gate.uvicorn")
_quiet.setLevel(logging.ERROR)


@dataclass(frozen=True, slots=True)
class Deadlines:
    """Deadlines of a connection while others wait.

    Attributes:
        headers: time for the TLS handshake, and for the headers of a request [s].
        body: time for each :data:`PORTION` of a body [s].
    """

    headers: float
    body: float


class _Stage(Enum):
    """State that a connection has to leave before its deadline."""

    HEADERS = auto()
    BEGINNING = auto()
    """Of a body: the request is not handed on yet."""
    UPLOAD = auto()
    """The rest of the body of a request that was handed on."""
    WORK = auto()
    REST = auto()
    """Of a body whose request was answered without it."""
    ANSWERED = auto()


_PLACES = {
    _Stage.HEADERS: Place.UNFINISHED,
    _Stage.BEGINNING: Place.UNFINISHED,
    _Stage.UPLOAD: Place.WORKING,
    _Stage.WORK: Place.WORKING,
    _Stage.REST: Place.UNFINISHED,
    _Stage.ANSWERED: Place.IDLE,
}


class GateProtocol(H11Protocol):
    """One HTTP connection. It tells the gate where it stands, and ends what takes too long.

    Args:
        config, server_state, app_state: of uvicorn.
        connection: entry of the connection at the gate.
        deadlines: after which it ends.
    """

    def __init__(
        self,
        config: uvicorn.Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        connection: Connection,
        deadlines: Deadlines,
    ) -> None:
        super().__init__(config, server_state, app_state)
        self.logger = _quiet
        self._application = cast(ASGIApp, self.app)
        self.app = cast(Any, self._hand_on)
        self._connection, self._deadlines = connection, deadlines
        self._stage = _Stage.HEADERS
        self._handed_on = False
        self._received = 0
        self._deadline: asyncio.TimerHandle | None = None
        self._reader: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for headers."""
        super().connection_made(transport)
        self._connection.abort = transport.abort
        self._wait_for(_Stage.HEADERS)

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait for nothing any more."""
        self._connection.leave()
        _cancel(self._deadline)
        _cancel(self._reader)
        self._unset_keepalive_if_required()
        super().connection_lost(exc)
        # A circle less for the garbage collector.
        self.app = cast(Any, self._application)

    def data_received(self, data: bytes) -> None:
        """Take in what came."""
        self._received += len(data)
        super().data_received(data)

    def send_400_response(self, msg: str) -> None:
        """Refuse what is no HTTP, and close."""
        headers = {"Content-Type": "text/plain", "Connection": "close", **FOR_BROWSERS}
        # The body is at fault: its headers came before.
        if self.cycle is not None and not self.cycle.response_complete:
            name = CALL_HEADER.lower().encode()
            headers |= echoed(
                [value.decode("latin-1") for key, value in self.headers if key == name]
            )
        for event in (
            h11.Response(status_code=400, headers=list(headers.items()), reason=b"Bad Request"),
            h11.Data(data=msg.encode()),
            h11.EndOfMessage(),
        ):
            self.transport.write(self.conn.send(event) or b"")
        self.transport.close()

    def handle_events(self) -> None:
        """Go on with the request, and see where it stands then."""
        before = self.cycle
        super().handle_events()
        if self.cycle is not before:
            self._handed_on = False
        self._settle()

    def on_response_complete(self) -> None:
        """Go on to the next request."""
        super().on_response_complete()
        self._settle()

    def pause_writing(self) -> None:
        """Give the reader of the answer a time."""
        super().pause_writing()
        self._reader = self._later(READING_TIME, "answer")

    def resume_writing(self) -> None:
        """Go on: the answer is read."""
        _cancel(self._reader)
        super().resume_writing()

    def _settle(self) -> None:
        stage = self._present()
        if stage is not self._stage:
            self._wait_for(stage)

    def _present(self) -> _Stage:
        """Return the state of the connection by h11's account."""
        answered = self.cycle is None or self.cycle.response_complete
        if self.conn.their_state is h11.IDLE and (self.cycle is None or self.conn.trailing_data[0]):
            return _Stage.HEADERS
        if self.conn.their_state is h11.SEND_BODY:
            if answered:
                return _Stage.REST
            return _Stage.UPLOAD if self._handed_on else _Stage.BEGINNING
        return _Stage.ANSWERED if answered else _Stage.WORK

    def _wait_for(self, stage: _Stage) -> None:
        self._stage = stage
        self._connection.move(_PLACES[stage])
        _cancel(self._deadline)
        if stage is _Stage.HEADERS:
            self._deadline = self._later(self._deadlines.headers, "headers")
        elif stage in (_Stage.BEGINNING, _Stage.UPLOAD):
            self._wait_for_portion()
        elif stage is _Stage.REST:
            self._deadline = self._later(self._deadlines.body, "body")
        elif stage is _Stage.ANSWERED:
            # uvicorn closes an idle connection sooner, but not before the answer was read.
            self._deadline = self._later(READING_TIME, "answer")

    def _wait_for_portion(self) -> None:
        due = self._received + PORTION

        def look() -> None:
            # Where the application does not read on, the other side cannot send.
            if self._received >= due or self.flow.read_paused:
                self._wait_for_portion()
            else:
                self._connection.drop("body")

        self._deadline = self.loop.call_later(self._deadlines.body, look)

    def _later(self, seconds: float, reason: Reason) -> asyncio.TimerHandle:
        return self.loop.call_later(seconds, self._connection.drop, reason)

    async def _hand_on(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let the application have the request once the first portion of its body is there.

        An upload that waits is handed on after its headers, so that it can be refused by them.
        """
        headers = Headers(scope=scope)
        if "content-length" in headers and "transfer-encoding" in headers:
            # A proxy in front may see another end of this body (RFC 9112, 6.3).
            await self._refuse(send)
            return
        expecting = "expect" in headers
        upload = expecting or "transfer-encoding" in headers
        upload = upload or int(headers.get("content-length", 0)) > PORTION
        body, begun = bytearray(), None
        if not expecting:
            with suppress(TimeoutError):
                async with asyncio.timeout(UPLOAD_PAUSE if upload else None):
                    begun = await self._beginning(receive, body)
        if begun is not None and begun["type"] == "http.disconnect":
            return
        fresh = begun is None

        async def receive_all() -> Message:
            nonlocal begun, expecting, fresh
            if fresh:
                expecting = fresh = False
                return await self._beginning(receive, body)
            if begun is None:
                return await receive()
            message, begun = begun, None
            return message

        async def send_all(message: Message) -> None:
            if message["type"] == "http.response.start" and expecting:
                # Nobody can tell whether the body comes all the same.
                message = {**message, "headers": [*message["headers"], (b"connection", b"close")]}
            await send(message)

        await self._application(scope, receive_all, send_all)

    async def _beginning(self, receive: Receive, body: bytearray) -> Message:
        """Return the first portion of a body, or all of it; or that the other side has gone.

        ``body`` holds what came of it so far.
        """
        more = True
        while more and len(body) < PORTION:
            message = await receive()
            if message["type"] == "http.disconnect":
                return message
            body += message["body"]
            more = message["more_body"]
        self._handed_on = True
        self._settle()
        return {"type": "http.request", "body": bytes(body), "more_body": more}

    async def _refuse(self, send: Send) -> None:
        """Refuse a request that has two lengths, and close."""
        told = b"Content-Length and Transfer-Encoding: send one of them."
        fields = {
            "Content-Type": "text/plain",
            "Content-Length": str(len(told)),
            "Connection": "close",
            **FOR_BROWSERS,
        }
        headers = [(name.lower().encode(), value.encode()) for name, value in fields.items()]
        await send({"type": "http.response.start", "status": 400, "headers": headers})
        await send({"type": "http.response.body", "body": told})


def echoed(given: Sequence[str]) -> Mapping[str, str]:
    """Return the header that names the request in its answer, where the request has a valid one.

    Args:
        given: values of the header in the request.
    """
    valid = len(given) == 1 and _CALL.fullmatch(given[0])
    return {CALL_HEADER: given[0]} if valid else {}


def _cancel(timer: asyncio.TimerHandle | None) -> None:
    if timer is not None:
        timer.cancel()
