"""Watch: captures by the camera itself, its stored policy, and events of changes."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Coroutine, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any, Literal

from veilcam_client.wire.calibration import SignedCalibration
from veilcam_client.wire.events import Believed, Event, Gone, Seen, WatchChanged
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
from veilcam_server.camera.engine import CameraEngine, OnDevice, Publish
from veilcam_server.errors import ProblemError, StorageError, UnsteadyLightError
from veilcam_server.masks.source import Evidence
from veilcam_server.settings import Settings
from veilcam_server.system.clock import MachineClock
from veilcam_server.system.state_file import Report
from veilcam_server.watch.belief import Dynamics, Thresholds
from veilcam_server.watch.policy import WatchStore, resting
from veilcam_server.watch.sightings import Change, Fusion, Sight

TICK = 0.5
"""Period of checks of the clock where there are quiet hours [s]."""
_SOON = 0.05
"""Time until a capture that gave way to a caller is tried again [s]."""
_PATIENCE = 3
"""Longest time without a capture before the belief is forgotten, in periods or seconds."""


@dataclass(frozen=True, slots=True)
class Watched:
    """Parts of the daemon that a watch uses.

    Attributes:
        camera: camera whose panel is opaque while it does not look.
        on_device: function that does work on the device's thread.
        look: function that takes a capture, of which nothing leaves, and returns its evidence.
        busy: function that tells whether a caller waits for the device.
        publish: function that takes events.
        tell: function that takes states, which are not kept.
    """

    camera: CameraEngine
    on_device: OnDevice
    look: Callable[[], Coroutine[Any, Any, Evidence]]
    busy: Callable[[], bool]
    publish: Publish
    tell: Callable[[Event], None]


@dataclass(frozen=True, slots=True)
class WatchSetup:
    """Settings that a watch starts with.

    Attributes:
        policy: policy of the watch.
        store: store of the policy.
        clock: clock of the quiet hours.
        rests: reason for a panel that is opaque already, or None.
        thresholds: thresholds of captures of a thing.
        dynamics: rates at which things come and go.
        beat: True: the whole state is told at each look's time; False: changes alone.
    """

    policy: WatchPolicy
    store: WatchStore
    clock: MachineClock = field(default_factory=lambda: MachineClock(trusted=True))
    rests: str | None = None
    thresholds: Thresholds = Thresholds()  # noqa: RUF009 - immutable
    dynamics: Dynamics = Dynamics()  # noqa: RUF009 - immutable
    beat: bool = True


def open_watch(
    settings: Settings, calibration: SignedCalibration | None, report: Report
) -> WatchSetup:
    """Return the setup of a daemon's watch.

    Args:
        settings: settings of the daemon.
        calibration: calibration in force, whose black level the thresholds follow.
        report: function that takes damage of the state directory.
    """
    store = WatchStore(settings.state_dir, settings.watch_policy, report)
    policy, thresholds = store.at_start(), Thresholds(seen=settings.watch_threshold)
    # A simulated camera has nothing to hide.
    clock = MachineClock(trusted=settings.trust_clock or settings.device == "simulated")
    return WatchSetup(
        policy,
        store,
        clock,
        rests=resting(policy, clock.now(), sure=clock.sure()),
        thresholds=thresholds if calibration is None else thresholds.calibrated(calibration.record),
        beat=settings.beat == "on",
    )


class Watcher:
    """Captures when they are due, the belief, and the history of labels, on one event loop.

    Args:
        setup: settings to start with.
        watched: parts of the daemon to use.
        clock: monotonic time [s].
        now: local time with its zone; by default that of the setup's clock.
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
        """Function that tells whether a caller holds the lease."""
        self._changing = asyncio.Lock()
        self._fusion = Fusion(setup.thresholds, setup.dynamics, MOST_SIGHTINGS)
        self._looks, self._due, self._last = 0, clock(), clock()
        self._activity, self._detail = self._planned()
        self._tick = clock() + self._period
        if isinstance(self.policy, Watching):
            self._tell_state()

    def state(self) -> Watch:
        """Return the activity, the belief and the history."""
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
        """Set the policy, also for after a restart.

        Raises:
            StorageError: the policy cannot be stored, and the one before goes on. Only ``off``
                holds all the same, until a restart.
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
            self._tick = self._due + self._period
            try:
                await self._settle()
            finally:
                self._enter(*self._planned(), told=changed)
            if unkept is not None:
                raise unkept
        return self.state()

    def rest_due_in(self) -> float:
        """Return the seconds until :meth:`rest` is due."""
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
        """Return the seconds until :meth:`look` is due; inf if it never is."""
        if not isinstance(self.policy, Watching) or self._rests is not None:
            return math.inf
        return max(0.0, self._due - self._clock())

    def beat_due_in(self) -> float:
        """Return the seconds until :meth:`beat` is due; inf if it never is."""
        if not self._setup.beat or self.look_due_in() == math.inf:
            return math.inf
        return max(0.0, self._tick - self._clock())

    async def beat(self) -> None:
        """Tell the whole state, whatever came of the looks, at the scheduled time of one."""
        # From the first tick on at fixed times: when a look ends may depend on the scene.
        self._tick += self._period * (1 + max(0.0, self._clock() - self._tick) // self._period)
        self._tell_state()

    async def look(self) -> None:
        """Take a capture, or give way to a caller.

        Raises:
            ProblemError: the capture failed.
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
            except UnsteadyLightError as error:
                # No failure, and no retry: the light changes, too, when somebody comes.
                self._due = max(self._due + period, self._clock())
                self._note_miss("waiting", str(error))
                return
            except ProblemError as error:
                self._miss(0.0, "waiting", str(error))
                raise
            # A capture does not count where the policy changed meanwhile.
            if self.policy is policy and self._reason() is None:
                self._due = max(self._due + period, self._clock())
                self._last, self._looks = began, self._looks + 1
                self._enter("looking")
                self._tell(self._fusion.take(evidence, began))

    def _miss(self, seconds: float, activity: Activity, detail: str) -> None:
        """Try again after some time."""
        self._due = self._clock() + seconds
        self._note_miss(activity, detail)

    def _note_miss(self, activity: Activity, detail: str) -> None:
        """Forget the belief once too many captures are missing."""
        missing = self._clock() - self._last
        if missing > _PATIENCE * max(1.0, self._period):
            self._enter(activity, detail)

    @property
    def _period(self) -> float:
        return 1 / self.policy.rate_hz if isinstance(self.policy, Watching) else math.inf

    async def _settle(self) -> None:
        """Make the panel opaque or not, by policy and clock."""
        reason = self._reason()
        if reason == self._rests:
            return
        self._rests = reason
        camera = self._watched.camera
        if reason is not None:
            await self._watched.on_device(lambda: camera.rest(reason))
        else:
            # The state tells why no mask is shown, and it is tried again.
            with suppress(ProblemError):
                await self._watched.on_device(camera.wake)
            self._due = self._last = self._clock()
            self._tick = self._due + self._period

    def _reason(self) -> str | None:
        return resting(self.policy, self._now(), sure=self._setup.clock.sure())

    def _planned(self) -> tuple[Activity, str | None]:
        """Return the activity by policy and clock, and its reason."""
        if isinstance(self.policy, WatchOff):
            return "off", self._reason()
        if (reason := self._reason()) is not None:
            return "quiet", reason
        return ("looking" if isinstance(self.policy, Watching) else "on_request"), None

    def _enter(self, activity: Activity, detail: str | None = None, *, told: bool = False) -> None:
        """Change the activity; the belief is forgotten unless the camera looks."""
        before, self._activity, self._detail = self._activity, activity, detail
        if activity != "looking":
            self._tell(self._fusion.stop())
        if told or activity != before:
            self._watched.publish(
                partial(WatchChanged, policy=self.policy, activity=activity, detail=detail)
            )
            self._tell_state()

    def _tell(self, changes: Sequence[Change]) -> None:
        for change in () if self._setup.beat else changes:
            self._watched.publish(_event(change))

    def _tell_state(self) -> None:
        if not self._setup.beat:
            return
        state = self.state()
        there = next((each for each in state.history[:1] if each.gone_at is None), None)
        self._watched.tell(
            Believed(id="", at=datetime.now(UTC), belief=state.belief, sighting=there)
        )


def _event(change: Change) -> Callable[..., Event]:
    """Return the function that makes the event of a change."""
    label, confidence, lasted = change.label, change.confidence, change.duration
    if change.kind == "seen":
        return partial(Seen, label=label, confidence=confidence, duration_s=lasted)
    reason: Literal["left", "not_looking"] = "not_looking" if confidence is None else "left"
    return partial(Gone, label=label, confidence=confidence, duration_s=lasted, reason=reason)
