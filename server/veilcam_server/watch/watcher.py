"""The watch: captures by itself, fuses what they tell, and says what changed."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Coroutine, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any, Literal, Protocol, TypeVar

from veilcam_client.wire.calibration import SignedCalibration
from veilcam_client.wire.events import Event, Gone, Seen, WatchChanged
from veilcam_client.wire.watch import (
    MOST_SIGHTINGS,
    Activity,
    Belief,
    Sighting,
    Watch,
    Watching,
    WatchOff,
    WatchPolicy,
)
from veilcam_server.camera.engine import CameraEngine, Publish
from veilcam_server.errors import ProblemError, StorageError
from veilcam_server.masks.source import Evidence
from veilcam_server.settings import Settings
from veilcam_server.system.clock import MachineClock
from veilcam_server.system.state_file import Report
from veilcam_server.watch.admission import Admission
from veilcam_server.watch.belief import Dynamics
from veilcam_server.watch.fusion import Fusion
from veilcam_server.watch.policy import WatchStore, resting
from veilcam_server.watch.sightings import Change, Sight

TICK = 0.5
"""Between two looks at the clock on the wall, where there are quiet hours [s]."""
_SOON = 0.05
"""After which a look that gave way to a caller is tried again [s]."""
_PATIENCE = 3
"""Periods, and seconds at least, that looks may be missing before nothing is believed any more."""

ResultT = TypeVar("ResultT")


class OnDevice(Protocol):
    """Does work on the device's thread."""

    def __call__(
        self, work: Callable[[], ResultT], *, counted: bool = True
    ) -> Coroutine[Any, Any, ResultT]:
        """Return what ``work`` returns, and raise what it raises."""


@dataclass(frozen=True, slots=True)
class Watched:
    """Parts of the daemon that a watch uses.

    Attributes:
        camera: camera whose panel is opaque while it does not look.
        on_device: does work on the device's thread.
        look: takes one capture, of which nothing leaves, and returns what it tells.
        busy: function that says whether a caller waits for the device.
        publish: takes events.
    """

    camera: CameraEngine
    on_device: OnDevice
    look: Callable[[], Coroutine[Any, Any, Evidence]]
    busy: Callable[[], bool]
    publish: Publish


@dataclass(frozen=True, slots=True)
class WatchSetup:
    """Settings that a watch starts with.

    Attributes:
        policy: policy of the watch.
        store: store of the policy.
        clock: clock of the quiet hours.
        rests: why the panel is opaque already; None: it is not.
        admission: test of a capture: does it look like one of a thing.
        dynamics: rates at which things come and go.
    """

    policy: WatchPolicy
    store: WatchStore
    clock: MachineClock = field(default_factory=lambda: MachineClock(trusted=True))
    rests: str | None = None
    admission: Admission = Admission()  # noqa: RUF009 - immutable
    dynamics: Dynamics = Dynamics()  # noqa: RUF009 - immutable


def open_watch(
    settings: Settings, calibration: SignedCalibration | None, report: Report
) -> WatchSetup:
    """Return what the watch of a daemon starts with.

    Args:
        settings: checked.
        calibration: calibration in force, which says how dark it is without light.
        report: takes what was damaged in the state directory.
    """
    store = WatchStore(settings.state_dir, settings.watch_policy, report)
    policy, admission = store.at_start(), Admission()
    # A simulated camera has nothing to hide.
    clock = MachineClock(trusted=settings.trust_clock or settings.device == "simulated")
    return WatchSetup(
        policy,
        store,
        clock,
        rests=resting(policy, clock.now(), sure=clock.sure()),
        admission=admission if calibration is None else admission.calibrated(calibration.record),
    )


class Watcher:
    """Looks when it is due, and remembers labels alone. Lives on one event loop.

    Args:
        setup: settings to start with.
        watched: parts of the daemon to use.
        clock: monotonic time [s].
        now: time of day, with its zone; by default that of the setup's clock.
    """

    def __init__(
        self,
        setup: WatchSetup,
        watched: Watched,
        *,
        clock: Callable[[], float] = time.monotonic,
        now: Callable[[], datetime] | None = None,
    ) -> None:
        self._setup, self._watched, self._clock = setup, watched, clock
        self._now = now or setup.clock.now
        self.policy, self._rests = setup.policy, setup.rests
        self.leased: Callable[[], bool] = lambda: False
        """Whether somebody holds the camera for himself."""
        self._changing = asyncio.Lock()
        self._fusion = Fusion(setup.admission, setup.dynamics, MOST_SIGHTINGS)
        self._looks, self._due, self._last = 0, clock(), clock()
        self._activity, self._detail = self._planned()

    def state(self) -> Watch:
        """Return whether the camera looks, and what it believes to see."""
        clock, now = self._clock(), datetime.now(UTC)
        leader = self._fusion.leader

        def at(instant: float) -> datetime:
            return now - timedelta(seconds=max(0.0, clock - instant))

        def sighting(sight: Sight) -> Sighting:
            until = clock if sight.until is None else sight.until
            return Sighting(
                label=sight.label,
                confidence=sight.confidence,
                seen_at=at(sight.since),
                gone_at=None if sight.until is None else at(sight.until),
                duration_s=max(0.0, until - sight.since),
            )

        return Watch(
            policy=self.policy,
            activity=self._activity,
            detail=self._detail,
            looks=self._looks,
            belief=None
            if leader is None
            else Belief(
                label=leader.label,
                confidence=leader.confidence,
                since=at(leader.since),
                duration_s=max(0.0, clock - leader.since),
                looks=leader.looks,
            ),
            history=tuple(map(sighting, self._fusion.history)),
            clock=self._setup.clock.told(),
        )

    async def set_policy(self, policy: WatchPolicy) -> Watch:
        """Change when the camera looks, also after a restart.

        Raises:
            StorageError: that cannot be made durable; the policy before goes on, unless the
                camera was to be switched off: that holds until a restart.
            DisplayError: the panel does not become opaque, which is tried again.
        """
        async with self._changing:
            unkept: StorageError | None = None
            try:
                await asyncio.to_thread(self._setup.store.set, policy)
            except StorageError as error:
                if not isinstance(policy, WatchOff):
                    raise
                unkept = error
            changed, self.policy = policy != self.policy, policy
            self._due = self._clock()
            try:
                await self._settle()
            finally:
                self._enter(*self._planned(), told=changed)
            if unkept is not None:
                raise unkept
        return self.state()

    def rest_due_in(self) -> float:
        """Seconds until it is due to see whether the panel is to be opaque, or not any more."""
        if self._reason() != self._rests:
            return 0.0
        hours = None if isinstance(self.policy, WatchOff) else self.policy.quiet
        return math.inf if hours is None else TICK

    async def rest(self) -> None:
        """Make the panel opaque, or show a mask again; raises :class:`DisplayError`."""
        async with self._changing:
            try:
                await self._settle()
            finally:
                self._enter(*self._planned())

    def look_due_in(self) -> float:
        """Seconds until a look is due; inf: it does not look by itself."""
        if not isinstance(self.policy, Watching) or self._rests is not None:
            return math.inf
        return max(0.0, self._due - self._clock())

    async def look(self) -> None:
        """Take a capture, or give way to who is to have the camera first.

        Raises:
            ProblemError: the camera took none.
        """
        policy, began = self.policy, self._clock()
        if not isinstance(policy, Watching):
            return
        period = 1 / policy.rate_hz
        condition = self._watched.camera.state
        if self.leased():
            self._miss(period, "leased", "somebody holds the camera")
        elif condition.state != "ready":
            self._miss(period, "waiting", condition.detail or f"the camera is {condition.state}")
        elif self._watched.busy():
            self._miss(_SOON, "waiting", "others take captures all the time")
        else:
            try:
                evidence = await self._watched.look()
            except ProblemError as error:
                self._miss(0.0, "waiting", str(error))
                raise
            # What was switched off in the meantime has not looked.
            if self.policy is policy and self._reason() is None:
                self._due = max(self._due + period, self._clock())
                self._last, self._looks = began, self._looks + 1
                self._enter("looking")
                self._tell(self._fusion.take(evidence, began))

    def _miss(self, seconds: float, activity: Activity, detail: str) -> None:
        """Look again so much later; believe nothing more once too many looks are missing."""
        self._due = self._clock() + seconds
        missing = self._clock() - self._last
        if missing > _PATIENCE * max(1.0, self._period):
            self._enter(activity, detail)

    @property
    def _period(self) -> float:
        return 1 / self.policy.rate_hz if isinstance(self.policy, Watching) else math.inf

    async def _settle(self) -> None:
        """Let the panel be as policy and clock want it."""
        reason = self._reason()
        if reason == self._rests:
            return
        self._rests = reason
        camera = self._watched.camera
        if reason is not None:
            await self._watched.on_device(lambda: camera.rest(reason))
        else:
            # Why no mask is shown, the state tells, and it is tried again.
            with suppress(ProblemError):
                await self._watched.on_device(camera.wake)
            self._due = self._last = self._clock()

    def _reason(self) -> str | None:
        return resting(self.policy, self._now(), sure=self._setup.clock.sure())

    def _planned(self) -> tuple[Activity, str | None]:
        """Return the activity where nothing is in the way, and why."""
        if isinstance(self.policy, WatchOff):
            return "off", self._reason()
        if (reason := self._reason()) is not None:
            return "quiet", reason
        return ("looking" if isinstance(self.policy, Watching) else "on_request"), None

    def _enter(self, activity: Activity, detail: str | None = None, *, told: bool = False) -> None:
        """Do something else from now on; what was believed is forgotten unless it looks."""
        before, self._activity, self._detail = self._activity, activity, detail
        if activity != "looking":
            self._tell(self._fusion.stop())
        if told or activity != before:
            self._watched.publish(
                partial(WatchChanged, policy=self.policy, activity=activity, detail=detail)
            )

    def _tell(self, changes: Sequence[Change]) -> None:
        for change in changes:
            self._watched.publish(_event(change))


def _event(change: Change) -> Callable[..., Event]:
    """Return the maker of the event of a change."""
    label, confidence, lasted = change.label, change.confidence, change.duration
    if change.kind == "seen":
        return partial(Seen, label=label, confidence=confidence, duration_s=lasted)
    reason: Literal["left", "not_looking"] = "not_looking" if confidence is None else "left"
    return partial(Gone, label=label, confidence=confidence, duration_s=lasted, reason=reason)
