"""Panel and rotation: a mask, once it is proven that the panel hides the scene, or opaque.

When a write fails, the mask shown before is put back; when that fails too, or a self test does, the
panel is made opaque and no mask counts as shown: state ``safe``, or ``degraded`` where nothing says
that the panel is at fault. An epoch whose mask goes from the panel for good is retired.
"""

from __future__ import annotations

import math
import time
from functools import partial

from veilcam_client.wire.events import MaskChanged, StateChanged
from veilcam_client.wire.rotation import Preparation as PreparationStatus
from veilcam_client.wire.rotation import Rotation, RotationOff, RotationPolicy
from veilcam_client.wire.status import Remedy, State
from veilcam_server.camera.capture import ActiveMask, Lateness, due_in, reusable
from veilcam_server.camera.engine import Condition, Publish
from veilcam_server.camera.epochs import Epoch, Preparation
from veilcam_server.camera.guard import Guard
from veilcam_server.camera.self_test import SelfTestStatus
from veilcam_server.devices.base import Display, Shown
from veilcam_server.devices.errors import DeviceError, DisplayError, SensorError
from veilcam_server.errors import (
    FenceError,
    PanelNotHidingError,
    ProblemError,
    RotationImpossibleError,
    UndecidedError,
    UnwatchableError,
    remedy_for,
)
from veilcam_server.masks.source import MaskSource


class MaskedPanel:
    """The panel and the state that follows from it. Called by one thread at a time.

    Args:
        display: display that shows masks.
        preparation: makes epochs ready.
        self_test: test that the panel hides the scene.
        guard: writes masks, each after an opaque frame.
    """

    def __init__(
        self,
        display: Display,
        preparation: Preparation,
        self_test: SelfTestStatus,
        guard: Guard,
    ) -> None:
        self._display, self._preparation, self._self_test = display, preparation, self_test
        self._guard = guard
        self.active: ActiveMask | None = None
        """The mask that is shown; None: there is none."""
        self._condition = Condition("starting")
        self.publish: Publish = lambda _: None
        """Takes every new epoch and state."""

    @property
    def state(self) -> Condition:
        """State of the camera."""
        return self._condition

    def proven_for(self) -> float:
        """Seconds until the panel must be tested; 0: now, or again after a test that failed."""
        return 0.0 if self.active is None else self._self_test.holds_for()

    def show(self, epoch: Epoch, source: MaskSource | None = None) -> None:
        """Show a mask, after a test if that is due.

        Args:
            epoch: epoch of the mask; it is retired unless it is shown.
            source: source of the epoch; from then on the next ones come from it, too.

        Raises:
            SelfTestError, SensorError, FenceError: the panel is not proven to hide the scene.
            UnwatchableError: the mask hides hardly more than it leaks.
            DisplayError: the panel did not take it.
        """
        previous = self.active
        try:
            self._prove()
            self._require_watchable(epoch)
            shown = self._write(epoch, previous)
        except BaseException:
            epoch.retire()
            raise
        self.active = ActiveMask(epoch, shown.completed_at, shown.completed_at)
        self._preparation.last_mark = epoch.mask.mark
        if previous is not None:
            previous.epoch.retire()
        if source is not None:
            self._preparation.serve(source)
        self._enter("ready")
        self.publish(partial(MaskChanged, epoch=epoch.name))
        self._prepare_next()

    def _write(self, epoch: Epoch, previous: ActiveMask | None) -> Shown:
        """Write a mask to the panel, or put back the one before."""
        try:
            self._guard.cover(epoch.mask.levels)
            # From here on no mask counts as shown until the panel has confirmed one.
            self.active = None
            return self._guard.show(epoch.mask.levels)
        except DeviceError as error:
            self._put_back(previous, remedy_for(error))
            raise DisplayError(
                f"the mask could not be changed: {error}", remedy=remedy_for(error)
            ) from error
        except BaseException as error:
            self._put_back(previous, remedy_for(error))
            raise

    def test(self) -> None:
        """Test the panel if a mask is shown and that is due, and put the mask back.

        Raises:
            SelfTestError, SensorError, FenceError: the panel is not proven to hide the scene.
        """
        active = self.active
        if active is not None and self._self_test.holds_for() <= 0:
            self._prove()
            self._put_back(active)

    @property
    def covered(self) -> bool:
        """Return whether the shown mask is under an opaque window still."""
        return self.active is not None and self._guard.covered

    def uncover(self) -> None:
        """Write the mask again that an opaque frame covers."""
        if self.active is not None and self._guard.covered:
            self._put_back(self.active)

    def fail(self, error: DisplayError) -> None:
        """Put the mask back after the panel failed at an opaque frame, or make it safe."""
        self._put_back(self.active, error.remedy)

    def give_up(self, error: SensorError) -> None:
        """No mask is shown any more before a test, as the sensor behind it fails."""
        self._self_test.void()
        self._drop()
        self._make_opaque("degraded", str(error), error.remedy)

    def accuse(self, error: PanelNotHidingError) -> None:
        """Reset the panel, initialise it and make it opaque, as it does not hide the scene."""
        self._drop()
        self._self_test.void()
        self._display.close()
        self._make_opaque("safe", str(error), error.remedy)

    def suspend(self) -> None:
        """No mask counts as shown: somebody has the panel for a calibration."""
        self._drop()
        self._enter("calibrating", "the camera is being calibrated")

    def rest(self, reason: str) -> None:
        """Be opaque because that is wanted: state ``off``, or ``safe`` where the panel fails."""
        self._drop()
        self._make_opaque("off", reason, None)

    def strand(self) -> None:
        """Be opaque after a calibration, if no mask could be shown."""
        if self._condition.state == "calibrating":
            self._make_opaque(
                "degraded", "no mask is shown after the calibration: it is tried again", "wait"
            )

    def end(self) -> None:
        """No mask counts as shown any more."""
        self._drop()
        self._enter("stopping", "the daemon is stopping")

    def _drop(self) -> None:
        """Retire the mask that was shown: it does not come back."""
        self._guard.forget()
        active, self.active = self.active, None
        if active is not None:
            active.epoch.retire()

    def _prove(self) -> None:
        """Test the panel if that is due; it then shows opaque, also after a test that failed."""
        if self._self_test.holds_for() > 0:
            return
        tested, self.active = self.active, None
        self._guard.forget()
        if self._condition.state in ("starting", "ready", "off", "calibrating"):
            self._enter("self-test", "the panel is being tested")
        try:
            self._self_test.renew()
        except BaseException as error:
            # What the panel cannot be blamed for is not called its failure.
            blameless = isinstance(error, (UndecidedError, SensorError, FenceError))
            known = isinstance(error, ProblemError)
            reason = str(error) if known else "the self test broke off"
            if tested is not None:
                tested.epoch.retire()
            self._make_opaque("degraded" if blameless else "safe", reason, remedy_for(error))
            raise
        self._guard.leak = self._self_test.leak

    def _require_watchable(self, epoch: Epoch) -> None:
        try:
            self._guard.require_watchable(epoch.mask.levels)
        except UnwatchableError as error:
            self._drop()
            # Whatever helps against light that leaks is seen by the next test.
            self._self_test.void()
            self._make_opaque("degraded", str(error), error.remedy)
            raise

    def _put_back(self, previous: ActiveMask | None, remedy: Remedy = "wait") -> None:
        """After a failed write, or a test: the mask from before, or else opaque."""
        self.active = None
        if previous is not None:
            try:
                shown = self._guard.show(previous.epoch.mask.levels)
            except BaseException as error:
                previous.epoch.retire()
                if not isinstance(error, Exception):
                    raise
                remedy = remedy_for(error)
            else:
                previous.completed_at = shown.completed_at
                self.active = previous
                self._prepare_next()
                self._enter("ready")
                return
        self._make_opaque("safe", "the panel failed and was made opaque: it is tried again", remedy)

    def _make_opaque(self, state: State, reason: str, remedy: Remedy | None) -> None:
        """Stop captures."""
        self._guard.forget()
        try:
            self._display.blank()
        except Exception as error:
            state, remedy = "safe", remedy_for(error)
            why = error if isinstance(error, ProblemError) else "its driver has a defect"
            reason = f"the panel cannot be made opaque: {why}"
        self._enter(state, reason, remedy)

    def _prepare_next(self) -> None:
        if self._preparation.renewable:
            self._preparation.begin()

    def _enter(self, state: State, detail: str | None = None, remedy: Remedy | None = None) -> None:
        condition = Condition(state, detail, remedy)
        if condition != self._condition:
            self._condition = condition
            self.publish(partial(StateChanged, **condition._asdict()))


class MaskRotation:
    """Policy of mask changes, and the mask that is shown by it.

    Args:
        panel: panel with the mask.
        preparation: makes epochs ready.
        policy: policy of mask changes.

    Raises:
        RotationImpossibleError: the policy needs another mask, and there is none.
    """

    def __init__(
        self, panel: MaskedPanel, preparation: Preparation, policy: RotationPolicy
    ) -> None:
        self._panel, self._preparation = panel, preparation
        self.lateness = Lateness()
        self.policy = policy

    @property
    def policy(self) -> RotationPolicy:
        """Policy of mask changes."""
        return self._policy

    @policy.setter
    def policy(self, policy: RotationPolicy) -> None:
        if not isinstance(policy, RotationOff):
            self.require_another()
        self._policy = policy

    @property
    def present(self) -> tuple[str | None, int]:
        """Name of the epoch shown (None: no mask) and the captures taken under it."""
        active = self._panel.active
        return (None, 0) if active is None else (active.epoch.name, active.captures)

    def due_in(self) -> float:
        """Seconds until the mask must change; inf when nothing is planned."""
        active = self._panel.active
        if active is None:
            return math.inf
        return due_in(
            self._policy,
            shown_for=time.monotonic() - active.since,
            captures=active.captures,
            chance=active.chance,
        )

    def may_reuse(self) -> bool:
        """Return whether a mask that is due may serve one more capture, too; that is counted."""
        active = self._panel.active
        if active is None or not self._preparation.under_way:
            return False
        return active.reuse(reusable(self._policy), self.lateness)

    def require_another(self) -> None:
        """Raise :class:`RotationImpossibleError` where there is no other mask."""
        if not self._preparation.renewable:
            raise RotationImpossibleError(
                "the bundle holds one pair only: serve a bundle with two or more to change masks"
            )

    def status(self) -> Rotation:
        """Return the policy, the present epoch, and whether the next one is ready."""
        active, preparation = self._panel.active, self._preparation
        epoch, captures = self.present
        return Rotation(
            policy=self._policy,
            epoch=epoch,
            epoch_age_s=None if active is None else time.monotonic() - active.since,
            captures=captures,
            preparation=PreparationStatus(
                ready=preparation.ready,
                prepared=preparation.count,
                last_s=preparation.took,
                late=self.lateness.late,
                reused=self.lateness.reused,
            ),
        )
