"""One camera, followed for ever: what it is, what happens, and whether it answers."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import replace

from veilcam_client import AsyncCamera, VeilcamError
from veilcam_client.errors import BusyError
from veilcam_client.wire.events import Event
from veilcam_mqtt.settings import Attempts
from veilcam_mqtt.view import View, calls_for_a_look, changes_what_is_seen

LOOK_EVERY = 5.0
"""Between two questions what is the case, whatever events tell [s]."""
log = logging.getLogger("veilcam.mqtt")


class Follower:
    """Tells what is known of a camera whenever that changes.

    Args:
        camera: camera that repeats nothing by itself, so that failures are known at once.
        on_view: called with what is known now.
        on_event: called with every event.
        clock: monotonic time [s].
    """

    def __init__(
        self,
        camera: AsyncCamera,
        on_view: Callable[[View], None],
        on_event: Callable[[Event], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._camera, self._clock = camera, clock
        self._on_view, self._on_event = on_view, on_event
        self._view: View | None = None
        self._look = asyncio.Event()
        self._changes = 0

    async def run(self) -> None:
        """Follow for ever; a camera that goes is waited for."""
        attempts = Attempts("camera")
        while True:
            answered, begun = self._view, self._clock()
            try:
                await self._follow()
            except* VeilcamError as errors:
                reason = str(errors.exceptions[0])
            reached = self._view is not None and self._view is not answered
            if self._view is not None:
                self._tell(replace(self._view, online=False))
            await attempts.failed(reason, lasted=self._clock() - begun if reached else None)

    async def _follow(self) -> None:
        """Until something fails."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._listen())
            tasks.create_task(self._ask())

    async def _ask(self) -> None:
        while True:
            self._look.clear()
            changes = self._changes
            try:
                status, watch = await self._camera.status(), await self._camera.watch.get()
            except BusyError:
                log.debug("the camera is too busy to say how it is")
            else:
                if self._changes != changes:
                    continue  # an event overtook the answer, which may be older than it
                if self._view is None or not self._view.online:
                    log.info("camera: %s", status.state)
                self._tell(View.of(status, watch, self._clock()))
            try:
                async with asyncio.timeout(LOOK_EVERY):
                    await self._look.wait()
            except TimeoutError:
                pass

    async def _listen(self) -> None:
        # One that breaks is how it is noticed that the camera is gone.
        async with self._camera.events(reconnect=False) as events:
            async for event in events:
                self._changes += changes_what_is_seen(event)
                if self._view is not None:
                    self._tell(self._view.after(event, self._clock()))
                self._on_event(event)
                if calls_for_a_look(event):
                    self._look.set()

    def _tell(self, view: View) -> None:
        self._view = view
        self._on_view(view)
