"""What the daemon tells of itself: events for who listens, a history, the log and systemd."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from datetime import datetime

import structlog

from veilcam_client.wire.calibration import CalibrationRun
from veilcam_client.wire.captures import BundleInfo, RotationPolicy, State
from veilcam_client.wire.events import (
    CalibrationChanged,
    CaptureTaken,
    Classified,
    Event,
    Fault,
    KeyringChanged,
    MaskChanged,
    RotationChanged,
    StateChanged,
)
from veilcam_server.events import EventLog
from veilcam_server.history import History
from veilcam_server.inference import Verdict
from veilcam_server.showing import Captured
from veilcam_server.systemd import notify

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

    def classified(self, name: str, captured: Captured, verdict: Verdict) -> None:
        """An embedding was classified."""
        self._publish(
            lambda id_, at: Classified(
                id=id_,
                at=at,
                capture=name,
                epoch=captured.epoch,
                label=verdict.label,
                confidence=verdict.confidence,
                replay=captured.replay is not None,
            )
        )

    def fault(self, code: str, detail: str) -> None:
        """Something failed."""
        log.warning("fault", code=code, detail=detail)
        self._publish(lambda id_, at: Fault(id=id_, at=at, code=code, detail=detail))

    def _publish(self, make: Callable[[str, datetime], Event]) -> None:
        self.history.add(self._events.publish(make))

    def _publish_from_thread(self, make: Callable[[str, datetime], Event]) -> None:
        self.on_loop(lambda: self._publish(make))


def _tell_state(state: State, detail: str | None) -> None:
    log.info("state", state=state, detail=detail)
    notify(f"STATUS={state}" if detail is None else f"STATUS={state}: {detail}")
