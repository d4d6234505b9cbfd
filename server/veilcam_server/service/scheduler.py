"""Scheduler of mask changes, self tests, looks and signs of life; alarms of what fails there."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from functools import partial

import structlog

from veilcam_client.wire.events import Event, StateChanged
from veilcam_client.wire.status import State
from veilcam_server.camera.engine import CameraEngine, Condition, Publish
from veilcam_server.errors import ProblemError, remedy_for
from veilcam_server.service.queue import DeviceQueue
from veilcam_server.system.logs import log_defect
from veilcam_server.system.systemd import notify, watchdog_period

log = structlog.get_logger()

LONGEST_PAUSE = 60.0
"""Between two attempts, however often they failed [s]."""

_DOWN = ("degraded", "safe")
"""States of a camera that takes no captures until its panel was tested again."""


_WELL = ("starting", "ready")
"""States of a camera that knows of nothing wrong."""


class Alarms:
    """A camera that is ready is ``degraded`` while a task around it fails. Lives on one event loop.

    Args:
        camera: camera whose state goes before.
        publish: takes every change of the state.
    """

    def __init__(self, camera: CameraEngine, publish: Publish) -> None:
        self._camera, self._publish = camera, publish
        self._sounding: dict[str, Condition] = {}

    @property
    def state(self) -> Condition:
        """State of the daemon."""
        return self._with_alarms(self._camera.state)

    def sound(self, task: str, error: Exception) -> None:
        """Let the state tell that a task failed; one that nobody foresaw is logged.

        Args:
            task: name of the task that failed, in words.
            error: error that it raised.
        """
        known = isinstance(error, ProblemError)
        if not known:
            log_defect(error, during=task)
        if self._camera.state.state not in _WELL:
            return  # the camera tells by itself what is wrong
        detail = str(error) if known else f"a defect in the {task}: it is tried again"
        before = self.state
        self._sounding[task] = Condition("degraded", detail, remedy_for(error))
        self._tell(before)

    def clear(self, task: str) -> None:
        """Let the state tell that a task is well again."""
        if task in self._sounding:
            before = self.state
            del self._sounding[task]
            self._tell(before)

    def guarded(self, task: str, take: Callable[[Event], None]) -> Callable[[Event], None]:
        """``take`` without its errors: they sound an alarm, until it takes an event again."""

        def taken(event: Event) -> None:
            try:
                take(event)
            except Exception as error:
                self.sound(task, error)
                return
            # An alarm is a change of the state: were it cleared by that, it might sound for ever.
            if not isinstance(event, StateChanged):
                self.clear(task)

        return taken

    def pass_on(self, make: Callable[..., Event]) -> None:
        """Publish an event of the camera; from whatever thread."""
        self._publish(partial(self._completed, make))

    def _completed(self, make: Callable[..., Event], **given: object) -> Event:
        event = make(**given)
        if not isinstance(event, StateChanged):
            return event
        condition = self._with_alarms(Condition(event.state, event.detail, event.remedy))
        return event.model_copy(update=condition._asdict())

    def _tell(self, before: Condition) -> None:
        if self.state != before:
            self._publish(partial(StateChanged, **self.state._asdict()))

    def _with_alarms(self, condition: Condition) -> Condition:
        if condition.state in _WELL:
            return next(iter(self._sounding.values()), condition)
        return condition


@dataclass(frozen=True, slots=True)
class _Task:
    """Repeated task."""

    name: str
    due_in: Callable[[], float]
    """Seconds until it must be done."""
    work: Callable[[], Awaitable[None]]
    changed: asyncio.Event = field(default_factory=asyncio.Event)
    """Set when it may be due earlier than was thought."""


class Scheduler:
    """Keeps a camera ready. Lives on one event loop.

    A task that fails, in whatever way, sounds an alarm and is tried again after a pause that grows
    from one failure to the next.

    Args:
        camera: camera that is maintained.
        queue: queue in front of its device.
        alarms: alarms of tasks that fail.
        watchdog: longest time between two signs of life [s]; None for none.
        tell: takes the signs of life.
        first_pause: after a first failure [s]; it doubles from one to the next.
    """

    def __init__(
        self,
        camera: CameraEngine,
        queue: DeviceQueue,
        alarms: Alarms,
        *,
        watchdog: float | None = None,
        tell: Callable[[str], None] = notify,
        first_pause: float = 1.0,
    ) -> None:
        self._camera, self._queue, self._alarms = camera, queue, alarms
        self._tell, self._first_pause = tell, first_pause
        self._down, self._down_since = False, -math.inf
        self._rotation = _Task("change of masks", camera.due_in, self._rotate)
        self._test = _Task("self test", self._test_due_in, self._test_panel)
        self._tasks = [self._rotation, self._test]
        watchdog = watchdog_period() if watchdog is None else watchdog
        if watchdog is not None:
            self._feed_every, self._fed, self._hung = watchdog / 2, -math.inf, False
            self._tasks.append(_Task("watchdog", self._feed_due_in, self._feed))

    def wake(self, event: Event | None = None) -> None:
        """Look again at what is due, whatever happened; for the event loop's thread."""
        if isinstance(event, StateChanged):
            self._note(event.state)
        for task in self._tasks:
            task.changed.set()

    def add(
        self, name: str, due_in: Callable[[], float], work: Callable[[], Awaitable[None]]
    ) -> None:
        """Do something else again and again, too; before this runs.

        Args:
            name: name in words.
            due_in: seconds until it must be done.
            work: does it.
        """
        self._tasks.append(_Task(name, due_in, work))

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Do what is due as long as the context lasts."""
        tasks = [asyncio.create_task(self._keep(task)) for task in self._tasks]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)

    async def _keep(self, task: _Task) -> None:
        """Do a task whenever it is due, whatever comes of it."""
        pause = self._first_pause
        while True:
            task.changed.clear()
            try:
                due = task.due_in()
                if due <= 0:
                    await task.work()
            except Exception as error:
                self._alarms.sound(task.name, error)
                await self._rest(task, pause)
                pause = min(2 * pause, LONGEST_PAUSE)
                continue
            self._alarms.clear(task.name)
            pause = self._first_pause
            if due > 0:
                await _wait(task.changed, due)

    async def _rest(self, task: _Task, seconds: float) -> None:
        """Pause before another attempt, unless it is not due any more."""
        ends = time.monotonic() + seconds
        while (left := ends - time.monotonic()) > 0:
            task.changed.clear()
            await _wait(task.changed, left)
            with suppress(Exception):
                if task.due_in() > 0:
                    return

    async def _rotate(self) -> None:
        """Change masks when the policy says so, also while nobody captures."""
        # A mask that is due waits for the next one here, where it keeps no capture waiting.
        await asyncio.to_thread(self._camera.await_next)
        try:
            await self._queue.run(self._camera.rotate_if_due)
        except Exception:
            # A panel that failed was set up anew, and is no longer proven.
            self._test.changed.set()
            raise

    def _note(self, state: State) -> None:
        """Note when the camera went down."""
        down = state in _DOWN
        if down and not self._down:
            self._down_since = time.monotonic()
        self._down = down

    def _test_due_in(self) -> float:
        due, state = self._camera.test_due_in(), self._camera.state.state
        # The event that tells of it may be on its way still.
        self._note(state)
        if state not in _DOWN:
            return due
        # What failed a moment ago, for whoever asked, is not tried again at once.
        return max(due, self._down_since + self._first_pause - time.monotonic())

    async def _test_panel(self) -> None:
        """Test the panel, and find the way back to ``ready``; the state tells what is wrong."""
        try:
            await self._queue.run(self._camera.test_if_due, told=False)
        except Exception:
            # What failed here has pauses of its own, which grow.
            self._down, self._down_since = True, -math.inf
            raise

    def _feed_due_in(self) -> float:
        return self._fed + self._feed_every - time.monotonic()

    async def _feed(self) -> None:
        """Say that the event loop runs and that the device answers."""
        self._fed = time.monotonic()
        if self._camera.healthy():
            self._hung = False
            self._tell("WATCHDOG=1")
        elif not self._hung:
            self._hung = True
            log.error("panel, camera or processor too slow: the watchdog is not fed any more")


async def _wait(event: asyncio.Event, seconds: float) -> None:
    """Wait for an event, but not longer than that."""
    # Not wait_for: in Python 3.11 it loses a cancellation that comes as the wait ends, and the
    # daemon would never stop.
    with suppress(TimeoutError):
        async with asyncio.timeout(seconds if math.isfinite(seconds) else None):
            await event.wait()
