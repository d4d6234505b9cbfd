"""File descriptors: how many the daemon may have, and how many of them may be connections."""

from __future__ import annotations

import resource
import sys
from dataclasses import dataclass

import structlog

log = structlog.get_logger()

RESERVE = 128
"""Files that are no connections: state, logs, camera, panel, listening sockets. A daemon with a
simulated camera has 20 open; libcamera opens some tens more, and buffers of frames."""


WAITING = 2048
"""Accepted sockets that may wait to come in, where files suffice."""


@dataclass(frozen=True, slots=True)
class Room:
    """Files that may be open for callers.

    Attributes:
        connections: number of connections that are let in.
        waiting: accepted sockets that wait to come in.
    """

    connections: int
    waiting: int


def room_for(connections: int) -> Room:
    """Return how many of so many connections there is room for beside :data:`RESERVE` files.

    Where the soft limit is too low, it is raised as far as the hard one allows. Where that is too
    low as well, waiting sockets have to do with less, and then connections.
    """
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    soft, hard = (sys.maxsize if one == resource.RLIM_INFINITY else one for one in limits)
    needed = connections + WAITING + RESERVE
    if soft < needed:
        soft = min(needed, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, limits[1]))
    # Never less than half of what there is for callers: a daemon that serves few beats none.
    free = max(soft - RESERVE, soft // 2)
    room = Room(min(connections, free * 3 // 4), min(WAITING, free - free * 3 // 4))
    if room.connections < connections:
        log.warning("few files may be open", connections=room.connections, files=soft)
    return Room(room.connections, min(WAITING, free - room.connections))
