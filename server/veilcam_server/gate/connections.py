"""Open connections, and which of them has to go when there is no room for another."""

from __future__ import annotations

import ipaddress
import itertools
from collections import Counter
from collections.abc import Callable
from enum import Enum
from typing import Literal

import structlog

from veilcam_server.system.logs import Throttle

log = structlog.get_logger()

LOCAL = "local socket"
"""Peer behind a unix socket."""

Reason = Literal["evicted", "refused", "handshake", "headers", "body", "answer"]
"""Why the gate ended a connection: there was no room, or it was not done in time with this."""


class Place(Enum):
    """State of a connection."""

    UNFINISHED = "unfinished"
    """Its handshake, its headers or the beginning of its body is not there yet."""
    IDLE = "idle"
    """Answered: it may ask again."""
    WORKING = "working"
    """Admitted, and not answered yet."""


def _nothing() -> None:
    """Do nothing: there is nothing to end."""


class Connection:
    """One open connection. It begins as unfinished.

    Attributes:
        peer: name of the other side.
        abort: ends it at once.
    """

    def __init__(self, connections: Connections, peer: str, since: int) -> None:
        self.peer, self.since, self.place = peer, since, Place.UNFINISHED
        self.abort: Callable[[], object] = _nothing
        self._connections = connections

    def move(self, place: Place) -> None:
        """Stand somewhere else; where it stood already, it keeps its age."""
        if place is not self.place:
            self._connections.move(self, place)

    def drop(self, reason: Reason) -> None:
        """End it at once."""
        self._connections.dropped[reason] += 1
        self.end()

    def end(self) -> None:
        """End it at once, without a reason that is counted."""
        abort = self.abort
        self.leave()
        abort()

    def leave(self) -> None:
        """Be counted no more; a second call does nothing."""
        self._connections.leave(self)
        # What ends it refers to it, too, and a circle lives until the garbage collector comes: with
        # TLS, 300 kB each.
        self.abort = _nothing


class _Peer:
    """Connections of one peer, in each place the oldest first."""

    def __init__(self) -> None:
        self.places: dict[Place, dict[Connection, None]] = {place: {} for place in Place}

    @property
    def total(self) -> int:
        return sum(map(len, self.places.values()))

    @property
    def evictable(self) -> int:
        return len(self.places[Place.UNFINISHED]) + len(self.places[Place.IDLE])


class Connections:
    """All connections to one daemon, at most ``limit``. Lives on one event loop.

    Where all places are taken, a new connection gets that of another one: of the peer with most
    connections that are not at work, the oldest that is unfinished, or else the oldest that is
    idle. So one peer pushes out itself and nobody else; and who shares its address with an attacker
    still gets in, and is through with its headers long before it is the oldest. What was admitted
    is never ended for others: how much of that there may be is limited for each caller.

    Args:
        limit: greatest number of connections.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.dropped: Counter[Reason] = Counter()
        """Connections that the gate ended, by reason."""
        self.failures = 0
        """Connections that could not be accepted."""
        self._peers: dict[str, _Peer] = {}
        self._numbers = itertools.count()
        self._open = 0
        self._full = Throttle()

    def __len__(self) -> int:
        return self._open

    def of(self, peer: str) -> int:
        """Return the number of connections of this peer."""
        found = self._peers.get(peer)
        return 0 if found is None else found.total

    def enter(self, peer: str) -> Connection | None:
        """Take in a new connection; None if nothing may go for it."""
        if self._open >= self.limit and not self.make_room():
            self.dropped["refused"] += 1
            return None
        connection = Connection(self, peer, next(self._numbers))
        self._peers.setdefault(peer, _Peer()).places[connection.place][connection] = None
        self._open += 1
        return connection

    def make_room(self) -> bool:
        """End the connection that others come before; False if there is none."""
        victim = self._victim()
        if (count := self._full.due()) is not None:
            log.warning(
                "connections full",
                limit=self.limit,
                times=count,
                peer=None if victim is None else victim.peer,
            )
        if victim is None:
            return False
        victim.drop("evicted")
        return True

    def end_all_but_working(self) -> None:
        """End every connection that nothing is being done for."""
        for peer in tuple(self._peers.values()):
            for place in (Place.UNFINISHED, Place.IDLE):
                for connection in tuple(peer.places[place]):
                    connection.end()

    def move(self, connection: Connection, place: Place) -> None:
        """Let an open connection stand somewhere else, as the youngest there."""
        if self._holds(connection):
            places = self._peers[connection.peer].places
            del places[connection.place][connection]
            connection.place, connection.since = place, next(self._numbers)
            places[place][connection] = None

    def leave(self, connection: Connection) -> None:
        """Count a connection no more."""
        if self._holds(connection):
            peer = self._peers[connection.peer]
            del peer.places[connection.place][connection]
            self._open -= 1
            if not peer.total:
                del self._peers[connection.peer]

    def _holds(self, connection: Connection) -> bool:
        peer = self._peers.get(connection.peer)
        return peer is not None and connection in peer.places[connection.place]

    def _victim(self) -> Connection | None:
        most = max((peer.evictable for peer in self._peers.values()), default=0)
        if not most:
            return None
        largest = [peer for peer in self._peers.values() if peer.evictable == most]
        for place in (Place.UNFINISHED, Place.IDLE):
            oldest = [next(iter(peer.places[place])) for peer in largest if peer.places[place]]
            if oldest:
                return min(oldest, key=lambda connection: connection.since)
        raise AssertionError("a peer has connections that stand nowhere")


def peer_of(address: object) -> str:
    """Name of who is at the other end.

    An IPv6 host usually has a whole /64 of addresses to itself, so that counts as one peer.

    Args:
        address: address as ``socket.accept`` gives it.
    """
    if not isinstance(address, tuple):
        return LOCAL
    host = ipaddress.ip_address(address[0].partition("%")[0])
    if isinstance(host, ipaddress.IPv4Address):
        return str(host)
    if host.ipv4_mapped is not None:
        return str(host.ipv4_mapped)
    return str(ipaddress.ip_network((host, 64), strict=False))
