"""What happened lately, for everyone who listens."""

from __future__ import annotations

import asyncio
import secrets
from collections import deque
from collections.abc import AsyncIterator, Callable
from datetime import UTC, datetime

from veilcam_client.wire.events import Event, Gap

CAPACITY = 1024


class EventLog:
    """The last events in order. Every listener has its own place in them, so none slows another.

    An id is ``BOOT-NUMBER``: it tells a listener that comes back whether it missed any, and
    whether the daemon was restarted. Lives on one event loop.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._boot = secrets.token_hex(4)
        self._events: deque[Event] = deque(maxlen=capacity)
        self._next = 0
        self._news = asyncio.Event()
        self._closed = False

    def publish(self, make: Callable[[str, datetime], Event]) -> Event:
        """Append the event that ``make`` builds from its id and the time, and return it."""
        event = make(self._id(self._next), datetime.now(UTC))
        self._events.append(event)
        self._next += 1
        self._wake()
        return event

    def close(self) -> None:
        """End every listener's stream."""
        self._closed = True
        self._wake()

    async def follow(
        self, last_event_id: str | None, heartbeat: float
    ) -> AsyncIterator[Event | None]:
        """Yield events after ``last_event_id`` (None: from now on), and None every quiet while.

        Args:
            last_event_id: the last one the listener has seen.
            heartbeat: longest silence [s].
        """
        position = self._next
        if last_event_id is not None:
            seen = self._number(last_event_id)
            position = self._first if seen is None else seen + 1
            if seen is None:
                yield self._gap(position, None)
        while not self._closed:
            if position < self._first:
                yield self._gap(self._first, self._first - position)
                position = self._first
            elif position < self._next:
                yield self._events[position - self._first]
                position += 1
            else:
                try:
                    async with asyncio.timeout(heartbeat):
                        await self._news.wait()
                except TimeoutError:
                    yield None

    @property
    def _first(self) -> int:
        return self._next - len(self._events)

    def _wake(self) -> None:
        self._news.set()
        self._news = asyncio.Event()

    def _id(self, number: int) -> str:
        return f"{self._boot}-{number}"

    def _number(self, event_id: str) -> int | None:
        """The number in an id of this boot, or None for any other text."""
        boot, _, number = event_id.partition("-")
        if boot != self._boot or not (number.isascii() and number.isdigit()):
            return None
        return min(int(number[:15]), self._next - 1)

    def _gap(self, position: int, missed: int | None) -> Gap:
        # Its id is that of the event before: who comes back with it goes on at ``position``.
        return Gap(id=self._id(max(position - 1, 0)), at=datetime.now(UTC), missed=missed)
