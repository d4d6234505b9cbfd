"""uvicorn behind the gate."""

from __future__ import annotations

import socket
from dataclasses import dataclass

import uvicorn

from veilcam_server.gate.connections import Connection, Connections
from veilcam_server.gate.descriptors import room_for
from veilcam_server.gate.entrance import Entrance
from veilcam_server.gate.protocol import Deadlines, GateProtocol
from veilcam_server.settings import Settings


@dataclass(frozen=True, slots=True)
class Gate:
    """Limits of the gate: connections, and their time.

    Attributes:
        connections: connections that are counted.
        deadlines: after which they end.
        waiting: accepted sockets that may wait to come in.
    """

    connections: Connections
    deadlines: Deadlines
    waiting: int


def open_gate(settings: Settings) -> Gate:
    """Return the gate of a daemon; it may raise how many files this process may open."""
    room = room_for(settings.connections)
    return Gate(
        Connections(room.connections),
        Deadlines(settings.header_timeout, settings.body_timeout),
        room.waiting,
    )


class GateServer(uvicorn.Server):
    """uvicorn, but for its accept loops, which take all that comes and know no deadline.

    Args:
        config: configuration of uvicorn. Its ``ssl`` holds for every socket.
        gate: limits of the gate.
    """

    def __init__(self, config: uvicorn.Config, gate: Gate) -> None:
        super().__init__(config)
        self._gate = gate
        self._entrance: Entrance | None = None

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start the application, then accept connections of ``sockets``."""
        # Of an empty list uvicorn makes no accept loop of its own.
        await super().startup([])
        if self.started:
            self._entrance = Entrance(
                sockets or [],
                self._gate.connections,
                self._protocol,
                tls=self.config.ssl,
                handshake=self._gate.deadlines.headers,
                waiting=self._gate.waiting,
            )
            self._entrance.open()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Accept nothing any more, then let requests end that are worked on."""
        if self._entrance is not None:
            self._entrance.close()
        self._gate.connections.end_all_but_working()
        await super().shutdown(sockets)

    def _protocol(self, connection: Connection) -> GateProtocol:
        return GateProtocol(
            self.config, self.server_state, self.lifespan.state, connection, self._gate.deadlines
        )
