"""What the daemon tells of itself: events for who listens, a history, the log and systemd."""

from __future__ import annotations

import asyncio
import secrets
from collections import Counter, deque
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime

import structlog

from veilcam_client.wire.bundles import BundleInfo
from veilcam_client.wire.calibration import CalibrationRun
from veilcam_client.wire.captures import Prediction
from veilcam_client.wire.diagnostics import PastFault, PastState
from veilcam_client.wire.events import (
    CalibrationChanged,
    CaptureTaken,
    Classified,
    Event,
    Fault,
    Gap,
    KeyringChanged,
    MaskChanged,
    RotationChanged,
    StateChanged,
)
from veilcam_client.wire.rotation import RotationPolicy
from veilcam_client.wire.status import State
from veilcam_server.camera.capture import Captured
from veilcam_server.errors import ProblemError
from veilcam_server.system.systemd import notify

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


LENGTH = 32
"""States and faults that are remembered."""


class History:
    """Takes note of every event."""

    def __init__(self) -> None:
        self.events: Counter[str] = Counter()
        """Events by kind."""
        self.faults: Counter[str] = Counter()
        """Faults by code."""
        self.last_states: deque[PastState] = deque(maxlen=LENGTH)
        self.last_faults: deque[PastFault] = deque(maxlen=LENGTH)

    def begin(self, state: State, detail: str | None) -> None:
        """Take note of the state in which the daemon begins, which no event tells of."""
        self.last_states.append(PastState(at=datetime.now(UTC), state=state, detail=detail))

    def add(self, event: Event) -> None:
        """Take note of one event."""
        self.events[event.kind] += 1
        if isinstance(event, Fault):
            self.faults[event.code] += 1
            self.last_faults.append(PastFault(at=event.at, code=event.code, detail=event.detail))
        elif isinstance(event, StateChanged):
            self.last_states.append(PastState(at=event.at, state=event.state, detail=event.detail))


log = structlog.get_logger()


class News:
    """Tells of what happens. Lives on one event loop, while it is open.

    Args:
        heartbeat: longest silence of an event stream [s].
    """

    def __init__(self, heartbeat: float) -> None:
        self.history = History()
        self._events, self._heartbeat = EventLog(), heartbeat
        self._loop: asyncio.AbstractEventLoop | None = None

    @contextmanager
    def open(self, state: State, detail: str | None) -> Iterator[None]:
        """Tell of what happens within, from ``state`` on; call it on the event loop."""
        self._loop = asyncio.get_running_loop()
        _tell_state(state, detail)
        self.history.begin(state, detail)
        try:
            yield
        finally:
            self._loop = None

    def follow(self, last_event_id: str | None) -> AsyncIterator[Event | None]:
        """Events after ``last_event_id``; None is a heartbeat."""
        return self._events.follow(last_event_id, self._heartbeat)

    def end_streams(self) -> None:
        """End all event streams."""
        self._events.close()

    def on_loop(self, act: Callable[[], None]) -> None:
        """Call ``act`` on the event loop, from whatever thread, unless that has ended."""
        loop = self._loop
        if loop is not None:
            loop.call_soon_threadsafe(act)

    def mask_changed(self, epoch: str) -> None:
        """Another mask is shown; from whatever thread."""
        self._publish_from_thread(lambda id_, at: MaskChanged(id=id_, at=at, epoch=epoch))

    def state_changed(self, state: State, detail: str | None) -> None:
        """The camera is in another state; from whatever thread."""
        _tell_state(state, detail)
        self._publish_from_thread(
            lambda id_, at: StateChanged(id=id_, at=at, state=state, detail=detail)
        )

    def calibration_changed(self, run: CalibrationRun) -> None:
        """A calibration has come further; from whatever thread."""
        self._publish_from_thread(lambda id_, at: CalibrationChanged(id=id_, at=at, run=run))

    def policy_changed(self, policy: RotationPolicy) -> None:
        """Masks change by another policy."""
        self._publish(lambda id_, at: RotationChanged(id=id_, at=at, policy=policy))

    def keyring_changed(self, bundle: BundleInfo) -> None:
        """Another keyring is in use."""
        self._publish(
            lambda id_, at: KeyringChanged(id=id_, at=at, digest=bundle.digest, task=bundle.task)
        )

    def captured(self, name: str, captured: Captured) -> None:
        """An embedding was taken."""
        self._publish(
            lambda id_, at: CaptureTaken(
                id=id_,
                at=at,
                capture=name,
                epoch=captured.epoch,
                replay=captured.replay is not None,
            )
        )

    def classified(self, name: str, captured: Captured, prediction: Prediction) -> None:
        """An embedding was classified."""
        self._publish(
            lambda id_, at: Classified(
                id=id_,
                at=at,
                capture=name,
                epoch=captured.epoch,
                label=prediction.label,
                confidence=prediction.confidence,
                replay=captured.replay is not None,
            )
        )

    def fault(self, error: ProblemError) -> None:
        """Something failed."""
        code, detail = error.code, str(error)
        log.warning("fault", code=code, detail=detail)
        self._publish(lambda id_, at: Fault(id=id_, at=at, code=code, detail=detail))

    def _publish(self, make: Callable[[str, datetime], Event]) -> None:
        self.history.add(self._events.publish(make))

    def _publish_from_thread(self, make: Callable[[str, datetime], Event]) -> None:
        self.on_loop(lambda: self._publish(make))


def _tell_state(state: State, detail: str | None) -> None:
    log.info("state", state=state, detail=detail)
    notify(f"STATUS={state}" if detail is None else f"STATUS={state}: {detail}")
