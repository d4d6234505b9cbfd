"""Scheduler of what nobody asks for: mask changes, self tests, and the watchdog's signs of life."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress

import structlog

from veilcam_client.wire.events import Event
from veilcam_server.camera.engine import CameraEngine
from veilcam_server.errors import ProblemError
from veilcam_server.service.queue import DeviceQueue
from veilcam_server.system.systemd import notify, watchdog_period

log = structlog.get_logger()

LONGEST_PAUSE = 60.0
"""Between two attempts, however often they failed [s]."""


class Scheduler:
    """Keeps a camera ready. Lives on one event loop.

    Args:
        camera: that is kept.
        queue: in front of its device.
        watchdog: longest time between two signs of life [s]; None for none.
        tell: takes the signs of life.
        first_pause: after a first failure [s]; it doubles from one to the next.
    """

    def __init__(
        self,
        camera: CameraEngine,
        queue: DeviceQueue,
        *,
        watchdog: float | None = None,
        tell: Callable[[str], None] = notify,
        first_pause: float = 1.0,
    ) -> None:
        self._camera, self._queue = camera, queue
        self._watchdog = watchdog_period() if watchdog is None else watchdog
        self._tell, self._first_pause = tell, first_pause
        self._rotation_changed, self._test_changed = asyncio.Event(), asyncio.Event()

    def wake(self, _: Event | None = None) -> None:
        """Look again at what is due, whatever happened; for the event loop's thread."""
        self._rotation_changed.set()
        self._test_changed.set()

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Do what is due as long as the context lasts."""
        works = [self._rotate(), self._test()]
        if self._watchdog is not None:
            works.append(self._live(self._watchdog / 2))
        tasks = [asyncio.create_task(work) for work in works]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)

    async def _rotate(self) -> None:
        """Change masks when the policy says so, also while nobody captures."""
        pause = self._first_pause
        while True:
            self._rotation_changed.clear()
            due = self._camera.due_in()
            if due > 0:
                await _wait(self._rotation_changed, due)
                continue
            # A mask that is due waits for the next one here, where it keeps no capture waiting.
            await asyncio.to_thread(self._camera.await_next)
            if await self._succeeds(self._camera.rotate_if_due, "rotation"):
                pause = self._first_pause
                continue
            # A panel that failed was set up anew, and is no longer proven.
            self._test_changed.set()
            await asyncio.sleep(pause)
            pause = min(2 * pause, LONGEST_PAUSE)

    async def _test(self) -> None:
        """Test the panel when that is due, and find the way back to ``ready``."""
        pause = self._first_pause
        while True:
            self._test_changed.clear()
            due = self._camera.test_due_in()
            if due > 0:
                pause = self._first_pause
                await _wait(self._test_changed, due)
                continue
            if self._camera.state[0] != "ready":
                await asyncio.sleep(pause)
                pause = min(2 * pause, LONGEST_PAUSE)
                if self._camera.test_due_in() > 0:
                    continue
            await self._succeeds(self._camera.test_if_due, "self test", told=False)

    async def _succeeds(self, work: Callable[[], None], name: str, *, told: bool = True) -> bool:
        """Whether ``work`` did not fail; the state tells of failures that are known."""
        try:
            await self._queue.run(work, told=told)
        except ProblemError:
            return False
        except Exception as error:
            log.error("defect", error=type(error).__name__, during=name)
            return False
        return True

    async def _live(self, every: float) -> None:
        """Say that the event loop runs and that the device answers."""
        hung = False
        while True:
            if self._camera.healthy():
                hung = False
                self._tell("WATCHDOG=1")
            elif not hung:
                hung = True
                log.error("panel, camera or processor too slow: the watchdog is not fed any more")
            await asyncio.sleep(every)


async def _wait(event: asyncio.Event, seconds: float) -> None:
    """Wait for an event, but not longer than that."""
    # Not wait_for: in Python 3.11 it loses a cancellation that comes as the wait ends, and the
    # daemon would never stop.
    with suppress(TimeoutError):
        async with asyncio.timeout(seconds if math.isfinite(seconds) else None):
            await event.wait()
