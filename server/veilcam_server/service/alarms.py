"""Alarms of tasks that fail, and the state that follows from them and from the camera."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from veilcam_client.wire.events import Event, StateChanged
from veilcam_server.camera.engine import CameraEngine, Condition, Publish
from veilcam_server.errors import ProblemError, remedy_for
from veilcam_server.system.logs import log_defect

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
