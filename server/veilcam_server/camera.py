"""The engine: one panel, one sensor, one lock, and the rule that no reading mixes two masks.

Mask, reader and epoch change as one. A capture is exposed wholly under one settled mask, which is
checked before and after (the fence), or it is an error. When the panel fails, the mask shown
before is put back; when that fails too, the panel is made opaque and captures stop: state ``safe``.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from datetime import UTC, datetime

from veilcam_client.models import RotationOff, RotationPolicy, State
from veilcam_server.devices.errors import DeviceError, DisplayError
from veilcam_server.devices.protocols import Device
from veilcam_server.errors import EpochError, FenceError, NotReadyError, RotationImpossibleError
from veilcam_server.fence import Fence, check_exposure
from veilcam_server.preparation import Preparation
from veilcam_server.rotation import due_in, reusable
from veilcam_server.showing import Captured, Lateness, Showing


class MaskedCamera:
    """Takes captures and changes masks, one thing at a time. Blocks: call it from a thread.

    Args:
        device: panel and sensor.
        preparation: makes epochs ready; closed with this.
        shape: of an embedding.
        fence: times to keep.
        policy: when masks change.

    Raises:
        RotationImpossibleError: the policy needs another mask, and there is none.
    """

    def __init__(
        self,
        device: Device,
        preparation: Preparation,
        shape: tuple[int, ...],
        *,
        fence: Fence = Fence(),  # noqa: B008 - immutable
        policy: RotationPolicy = RotationOff(),  # noqa: B008 - immutable
    ) -> None:
        self._device, self._preparation = device, preparation
        self._shape, self._fence = shape, fence
        self._on_mask: Callable[[str], None] = _ignore
        self._on_state: Callable[[State, str | None], None] = _ignore
        self._lock = threading.Lock()
        self._showing: Showing | None = None
        self._state: State = "starting"
        self._detail: str | None = None
        self.lateness = Lateness()
        self.policy = policy

    def listen(
        self,
        on_mask: Callable[[str], None],
        on_state: Callable[[State, str | None], None],
        on_ready: Callable[[], None],
    ) -> None:
        """Call back when the mask or the state changes, and when the next mask is ready.

        Callbacks are made while the device is busy, so they must neither block nor fail.

        Args:
            on_mask: takes the name of the new epoch.
            on_state: takes the new state, and why it is not ``ready``.
            on_ready: takes nothing; made on another thread.
        """
        self._on_mask, self._on_state = on_mask, on_state
        self._preparation.on_ready = on_ready

    @property
    def state(self) -> tuple[State, str | None]:
        """What the camera is doing, and why it is not ready."""
        return self._state, self._detail

    @property
    def preparation(self) -> Preparation:
        """What makes epochs ready."""
        return self._preparation

    @property
    def policy(self) -> RotationPolicy:
        """When masks change."""
        return self._policy

    @policy.setter
    def policy(self, policy: RotationPolicy) -> None:
        if not isinstance(policy, RotationOff):
            self._require_another()
        self._policy = policy

    @property
    def present(self) -> tuple[str | None, int]:
        """Name of the epoch shown (None: no mask) and the captures taken under it."""
        showing = self._showing
        return (None, 0) if showing is None else (showing.epoch, showing.captures)

    def due_in(self) -> float:
        """Seconds until the mask must change; inf when nothing is planned."""
        showing = self._showing
        if showing is None:
            return math.inf
        return due_in(
            self._policy,
            shown_for=time.monotonic() - showing.since,
            captures=showing.captures,
            chance=showing.chance,
        )

    def rotate(self) -> None:
        """Show the first mask, or another one now; from the state ``safe`` this is the way back.

        Waits for the next mask to be ready.

        Raises:
            RotationImpossibleError: there is no other mask.
            EpochError: its epoch could not be recorded.
            DisplayError: the panel did not take it; the mask shown before is back if possible,
                else the state is ``safe``.
        """
        with self._lock:
            self._rotate()

    def rotate_if_due(self) -> None:
        """Show another mask if the policy wants it and one is ready; raises as :meth:`rotate`."""
        with self._lock:
            if self.due_in() <= 0 and not self._preparation.under_way:
                self._rotate()

    def capture(self) -> Captured:
        """Take one reading under one mask.

        If the mask is due and the next is not ready, what the policy says is done: this capture
        reuses the mask, or it waits.

        Raises:
            NotReadyError: no mask is shown.
            SensorError: the sensor gave no reading.
            FenceError: it gave one that cannot be trusted.
            RotationImpossibleError, EpochError, DisplayError: the mask was due to change and
                could not; it is not used beyond what the policy allows.
        """
        with self._lock:
            begun = time.monotonic()
            if self.due_in() <= 0 and not self._may_reuse():
                self._rotate()
            showing = self._showing
            if showing is None:
                raise NotReadyError(self._detail or "no mask is shown yet: try again")
            rotated = time.monotonic()
            not_before = showing.completed_at + self._fence.settle
            taken_at = datetime.now(UTC)
            exposure = self._device.sensor.capture(not_before, self._fence.timeout)
            ended = time.monotonic()
            # Counted before it is checked: the light was collected, whatever comes of it.
            showing.captures += 1
            if self._showing is not showing:
                raise FenceError("the mask changed during the exposure, which was thrown away")
            check_exposure(exposure, not_before=not_before, ended=ended, shape=self._shape)
            waited = max(0.0, not_before - rotated)
            return Captured(
                embedding=exposure.embedding,
                taken_at=taken_at,
                epoch=showing.epoch,
                reader=showing.mask.reader,
                started_after_shown=exposure.started_at - showing.completed_at,
                settle=self._fence.settle,
                duration=exposure.ended_at - exposure.started_at,
                rotation_time=rotated - begun,
                settle_time=waited,
                capture_time=max(0.0, ended - rotated - waited),
            )

    def stop(self) -> None:
        """Show opaque and let go of the device; waits for a capture that is under way.

        Raises:
            DisplayError: the panel could not be made opaque; the device is let go all the same.
        """
        with self._lock:
            if self._state == "stopping":
                return
            self._enter("stopping", "the daemon is stopping")
            self._showing = None
            with ExitStack() as stack:
                stack.callback(self._preparation.close)
                stack.callback(self._device.close)
                self._device.display.blank()

    def _may_reuse(self) -> bool:
        """Whether a mask that is due may serve this capture, too, which is then counted."""
        showing = self._showing
        if showing is None or not self._preparation.under_way:
            return False
        if not showing.late:
            showing.late = True
            self.lateness.late += 1
        if showing.overdue >= reusable(self._policy):
            return False
        showing.overdue += 1
        self.lateness.reused += 1
        return True

    def _rotate(self) -> None:
        if self._state == "stopping":
            raise NotReadyError("the daemon is stopping")
        previous = self._showing
        if previous is not None:
            self._require_another()
        # The epoch is on the disk before its mask is on the panel, so none is ever shown twice.
        prepared = self._preparation.take()
        self._preparation.record(prepared.mask)
        # From here on no mask counts as shown until the panel has confirmed one.
        self._showing = None
        try:
            shown = self._device.display.show(prepared.mask.levels)
        except DeviceError as error:
            self._put_back(previous)
            raise DisplayError(f"the mask could not be changed: {error}") from error
        except BaseException:
            self._put_back(previous)
            raise
        self._showing = Showing(
            prepared.mask, prepared.epoch.name, shown.completed_at, shown.completed_at
        )
        self._enter("ready", None)
        self._on_mask(prepared.epoch.name)
        if self._preparation.renewable:
            self._preparation.begin()

    def _require_another(self) -> None:
        if not self._preparation.renewable:
            raise RotationImpossibleError(
                "the bundle holds one pair only: serve a bundle with two or more to change masks"
            )

    def _put_back(self, previous: Showing | None) -> None:
        """After a failed write: the mask from before, or else opaque."""
        if previous is not None:
            try:
                shown = self._device.display.show(previous.mask.levels)
            except DeviceError:
                pass
            else:
                previous.completed_at = shown.completed_at
                self._showing = previous
                # Should it not be recorded, another mask than the next is left out: no harm.
                with suppress(EpochError):
                    self._preparation.record(previous.mask)
                self._preparation.begin()
                return
        try:
            self._device.display.blank()
        except DeviceError:
            detail = "the panel failed and cannot be made opaque: check its power and wiring"
        else:
            detail = "the panel failed and was made opaque: rotate to try again"
        self._enter("safe", detail)

    def _enter(self, state: State, detail: str | None) -> None:
        if (state, detail) != (self._state, self._detail):
            self._state, self._detail = state, detail
            self._on_state(state, detail)


def _ignore(*_: object) -> None:
    """Nobody listens."""
