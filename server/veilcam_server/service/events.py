"""Events: published in order, followed over the network, counted, logged, and told to systemd."""

from __future__ import annotations

import asyncio
import secrets
import threading
from collections import Counter, deque
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial

import structlog

from veilcam_client.wire.events import (
    Classified,
    Event,
    Fault,
    Gap,
    Gone,
    Seen,
    StateChanged,
    WatchChanged,
)
from veilcam_client.wire.status import PastFault, PastState
from veilcam_server.system.systemd import notify

CAPACITY = 1024
LABELS = (Classified, Seen, Gone)
"""Events for callers with the scope ``classify`` alone."""


class EventLog:
    """The last events in order. Every listener has its own place in them, so none slows another.

    An id is ``BOOT-NUMBER``: it tells a listener that comes back whether it missed any, and
    whether the daemon was restarted. Lives on one event loop.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._boot = secrets.token_hex(4)
        self._events: deque[Event] = deque(maxlen=capacity)
        self._next = 0
        self._state: Event | None = None
        self._states = 0
        self._appended = asyncio.Event()
        self._closed = False

    def publish(self, make: Callable[..., Event]) -> Event:
        """Append the event that ``make`` builds from its ``id`` and the time, and return it."""
        event = make(id=self._id(self._next), at=datetime.now(UTC))
        self._events.append(event)
        self._next += 1
        self._wake()
        return event

    def tell(self, state: Event) -> None:
        """Give whoever listens a state, which has no id; the last one alone is kept."""
        self._state = state
        self._states += 1
        self._wake()

    def close(self) -> None:
        """End every listener's stream."""
        self._closed = True
        self._wake()

    def follow(self, last_event_id: str | None, heartbeat: float) -> AsyncIterator[Event | None]:
        """Yield events after ``last_event_id``, and None every quiet while.

        Args:
            last_event_id: the last one the listener has seen; None: all from this call on.
            heartbeat: longest silence [s].
        """
        return self._follow(last_event_id, heartbeat, self._next)

    async def _follow(
        self, last_event_id: str | None, heartbeat: float, position: int
    ) -> AsyncIterator[Event | None]:
        told = 0
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
            elif told < self._states and self._state is not None:
                told = self._states
                yield self._state
            else:
                try:
                    async with asyncio.timeout(heartbeat):
                        await self._appended.wait()
                except TimeoutError:
                    yield None

    @property
    def _first(self) -> int:
        return self._next - len(self._events)

    def _wake(self) -> None:
        self._appended.set()
        self._appended = asyncio.Event()

    def _id(self, number: int) -> str:
        return f"{self._boot}-{number}"

    def _number(self, event_id: str) -> int | None:
        """Return the number in an id of this boot, or None for any other text."""
        boot, _, number = event_id.partition("-")
        if boot != self._boot or not (number.isascii() and number.isdigit()):
            return None
        return min(int(number[:15]), self._next - 1)

    def _gap(self, position: int, missed: int | None) -> Gap:
        # Its id is that of the event before: who comes back with it goes on at ``position``.
        return Gap(id=self._id(max(position - 1, 0)), at=datetime.now(UTC), missed=missed)


LENGTH = 32
"""States and faults that are remembered."""


class History:
    """Takes note of every event; its counts tell nothing of what is seen."""

    def __init__(self) -> None:
        self.events: Counter[str] = Counter()
        """Events by kind, without those of the watch."""
        self.faults: Counter[str] = Counter()
        """Faults by code."""
        self.last_states: deque[PastState] = deque(maxlen=LENGTH)
        self.last_faults: deque[PastFault] = deque(maxlen=LENGTH)

    def enter(self, event: StateChanged) -> None:
        """Take note of a state, also of the first, which no stream tells of."""
        self.last_states.append(
            PastState(at=event.at, state=event.state, detail=event.detail, remedy=event.remedy)
        )

    def add(self, event: Event) -> None:
        """Take note of one event."""
        if not isinstance(event, Seen | Gone | WatchChanged):
            self.events[event.kind] += 1
        if isinstance(event, Fault):
            self.faults[event.code] += 1
            self.last_faults.append(
                PastFault(at=event.at, code=event.code, detail=event.detail, remedy=event.remedy)
            )
        elif isinstance(event, StateChanged):
            self.enter(event)


log = structlog.get_logger()


def _renamed(event: Event, **named: object) -> Event:
    """Return an event under another id."""
    return event.model_copy(update=named)


class EventPublisher:
    """Publishes what happens to whoever subscribed. Lives on one event loop, while it is open."""

    def __init__(self) -> None:
        self.log, self.public = EventLog(), EventLog()
        """Last events, for streams; ``public``: without labels, and with ids of their own."""
        self._subscribers: list[Callable[[Event], None]] = []
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread = 0
        self._delivering = self._waiting = False

    def subscribe(self, take: Callable[[Event], None]) -> None:
        """Let ``take`` have every event, on the event loop; it must neither block nor fail."""
        self._subscribers.append(take)

    @contextmanager
    def open(self) -> Iterator[None]:
        """Publish what happens within; call it on the event loop."""
        self._loop, self._thread = asyncio.get_running_loop(), threading.get_ident()
        try:
            yield
        finally:
            self._loop = None

    def publish(self, make: Callable[..., Event]) -> None:
        """Publish the event that ``make`` builds from its ``id`` and the time ``at``.

        From whatever thread; dropped while this is not open.
        """
        loop = self._loop
        if loop is None:
            return
        if threading.get_ident() == self._thread and not self._delivering:
            self._deliver(make)
        else:
            # What a subscriber publishes comes after what it was told of, for all of them.
            loop.call_soon_threadsafe(self._deliver, make)

    def _deliver(self, make: Callable[..., Event]) -> None:
        event = self.log.publish(make)
        if self._is_public(event):
            self.public.publish(partial(_renamed, event))
        self._delivering = True
        try:
            for take in self._subscribers:
                take(event)
        finally:
            self._delivering = False

    def _is_public(self, event: Event) -> bool:
        """Return whether callers without the scope ``classify`` are told of an event."""
        if not isinstance(event, WatchChanged):
            return not isinstance(event, LABELS)
        # A watch that waits may do so because the light changed, as somebody came.
        before, self._waiting = self._waiting, event.activity == "waiting"
        return not (self._waiting or (before and event.activity == "looking"))


def log_event(event: Event) -> None:
    """Write states and faults to the log; nothing else belongs there."""
    if isinstance(event, StateChanged):
        log.info("state", state=event.state, detail=event.detail, remedy=event.remedy)
    elif isinstance(event, Fault):
        log.warning("fault", code=event.code, detail=event.detail, remedy=event.remedy)


def tell_systemd(event: Event) -> None:
    """Let ``systemctl status`` show the state."""
    if isinstance(event, StateChanged):
        detail = "" if event.detail is None else f": {event.detail}"
        notify(f"STATUS={event.state}{detail}")
