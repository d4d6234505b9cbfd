"""The engine: one panel, one sensor, one lock, and the rule that no reading mixes two masks.

Mask, reader and epoch change as one. A capture is exposed wholly under one settled mask, which is
checked before and after (the fence), or it is an error. No capture is taken unless a self test has
proven that the panel hides the scene (``masked_panel.py``).
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from datetime import UTC, datetime
from typing import TypeVar

from veilcam_client.wire.calibration import SignedCalibration
from veilcam_client.wire.captures import RotationOff, RotationPolicy, State
from veilcam_server.camera.capture import Captured, Fence, Lateness, check_exposure
from veilcam_server.camera.epochs import Preparation, Prepared
from veilcam_server.camera.panel import MaskedPanel
from veilcam_server.camera.rotation import due_in, reusable
from veilcam_server.camera.self_test import EVERY, Proof, SelfTest
from veilcam_server.camera.watchdog import Health, stamped
from veilcam_server.devices.base import Device
from veilcam_server.devices.corrected import calibrated
from veilcam_server.errors import (
    CalibratingError,
    FenceError,
    NotReadyError,
    RotationImpossibleError,
)
from veilcam_server.masks.source import MaskSource

ResultT = TypeVar("ResultT")

_MARGIN = 15.0
"""What a capture may take beyond its timeout: a camera is closed and opened again [s]."""


class MaskedCamera:
    """Takes captures and changes masks, one thing at a time. Blocks: call it from a thread.

    Args:
        device: panel and sensor.
        preparation: makes epochs ready; closed with this.
        shape: of an embedding.
        test: proves that the panel hides the scene.
        fence: times to keep.
        policy: when masks change.
        test_every: longest time from one test to the next [s].
        calibration: what readings are corrected by.

    Raises:
        RotationImpossibleError: the policy needs another mask, and there is none.
    """

    def __init__(
        self,
        device: Device,
        preparation: Preparation,
        shape: tuple[int, ...],
        test: SelfTest,
        *,
        fence: Fence = Fence(),  # noqa: B008 - immutable
        policy: RotationPolicy = RotationOff(),  # noqa: B008 - immutable
        test_every: float = EVERY,
        calibration: SignedCalibration | None = None,
    ) -> None:
        self._health = Health(fence.settle + fence.timeout + _MARGIN)
        self._bare, self._preparation = stamped(device, self._health), preparation
        self._device = calibrated(self._bare, calibration)
        self._shape, self._fence = shape, fence
        self._proof = Proof(test, self._device, fence, every=test_every)
        self._panel = MaskedPanel(self._device.display, preparation, self._proof)
        self._lock = threading.Lock()
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
        self._panel.on_mask, self._panel.on_state = on_mask, on_state
        self._preparation.on_ready = on_ready

    @property
    def state(self) -> tuple[State, str | None]:
        """What the camera is doing, and why it is not ready."""
        return self._panel.state

    def healthy(self) -> bool:
        """Whether panel and camera still answer."""
        return self._health.healthy()

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
        showing = self._panel.showing
        return (None, 0) if showing is None else (showing.epoch, showing.captures)

    def due_in(self) -> float:
        """Seconds until the mask must change; inf when nothing is planned."""
        showing = self._panel.showing
        if showing is None:
            return math.inf
        return due_in(
            self._policy,
            shown_for=time.monotonic() - showing.since,
            captures=showing.captures,
            chance=showing.chance,
        )

    def test_due_in(self) -> float:
        """Seconds until the panel must be tested, or tested again after a test that failed."""
        if self.state[0] in ("stopping", "calibrating"):
            return math.inf
        return self._panel.proven_for()

    def test_if_due(self) -> None:
        """Test the panel if that is due, and show the mask again; raises as :meth:`rotate`.

        From the states ``safe`` and ``degraded`` this is the way back, and shows another mask.
        """
        with self._lock:
            if self._panel.showing is None:
                self._rotate()
            else:
                self._panel.test()

    def lend(self, work: Callable[[Device], ResultT]) -> ResultT:
        """Let ``work`` have the device as it is, without any calibration; raises what it does.

        No mask is shown and no capture taken from here on until :meth:`take_back`.

        Raises:
            NotReadyError: it is lent already, or the daemon is stopping.
        """
        with self._lock:
            self._require_running()
            self._panel.lend()
            return work(self._bare)

    def adopt(self, calibration: SignedCalibration, settle: float, source: MaskSource) -> None:
        """While the device is lent: go on with another calibration.

        Args:
            calibration: what readings are corrected by.
            settle: what the panel is given [s].
            source: whose readers are made for that calibration.
        """
        with self._lock:
            self._device = calibrated(self._bare, calibration)
            self._fence = Fence(settle, self._fence.timeout)
            self._preparation.serve(source)

    def take_back(self) -> None:
        """End what :meth:`lend` began: test the panel, and show a mask; raises as :meth:`rotate`.

        Where that fails, the state says why, and it is tried again as after any other failure.
        """
        with self._lock:
            if self.state[0] != "calibrating":
                return
            self._proof.void(self._device, self._fence)
            try:
                self._panel.show(self._preparation.take())
            finally:
                self._panel.strand()

    def rotate(self) -> None:
        """Show the first mask, or another one now; from any state this is the way to ``ready``.

        Waits for the next mask to be ready, and tests the panel first if that is due.

        Raises:
            SelfTestError: the panel is not proven to hide the scene, and was made opaque.
            SensorError, FenceError: the sensor did not see whether it does.
            RotationImpossibleError: there is no other mask.
            EpochError: its epoch could not be recorded.
            DisplayError: the panel did not take it; the mask shown before is back if possible,
                else the state is ``safe``.
        """
        with self._lock:
            self._rotate()

    def change_source(self, source: MaskSource, first: Prepared) -> None:
        """Show a mask of another source: from then on masks and their readers come from there.

        Args:
            source: for a camera and an embedding like these.
            first: of its epochs, prepared by this camera's preparation.

        Raises:
            RotationImpossibleError: the policy needs another mask, and the source has one only.
            SelfTestError, SensorError, FenceError, EpochError, DisplayError: as :meth:`rotate`;
                the source before goes on.
        """
        with self._lock:
            if not (isinstance(self._policy, RotationOff) or source.renewable):
                raise RotationImpossibleError(
                    "this keyring holds one mask only: turn the rotation of masks off first"
                )
            self._require_running()
            self._panel.show(first, source)

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
            NotReadyError: no mask is shown, or the panel is not proven to hide the scene.
            SensorError: the sensor gave no reading.
            FenceError: it gave one that cannot be trusted.
            RotationImpossibleError, EpochError, DisplayError: the mask was due to change and
                could not; it is not used beyond what the policy allows.
        """
        with self._lock:
            begun = time.monotonic()
            self._require_running()
            if self.due_in() <= 0 and not self._may_reuse():
                self._rotate()
            self._panel.test()
            showing = self._panel.showing
            if showing is None:
                raise NotReadyError(self.state[1] or "no mask is shown yet: try again")
            rotated = time.monotonic()
            not_before = showing.completed_at + self._fence.settle
            taken_at = datetime.now(UTC)
            exposure = self._device.sensor.capture(not_before, self._fence.timeout)
            ended = time.monotonic()
            # Counted before it is checked: the light was collected, whatever comes of it.
            showing.captures += 1
            if self._panel.showing is not showing:
                raise FenceError("the mask changed during the exposure, which was thrown away")
            check_exposure(exposure, not_before=not_before, ended=ended, shape=self._shape)
            scenes = self._device.scenes
            scene = None if scenes is None else scenes.seen
            if scenes is not None:
                scenes.advance()
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
                scene=scene,
            )

    def stop(self) -> None:
        """Stop the sensor, show opaque and let go; waits for a capture that is under way.

        Raises:
            DisplayError: the panel could not be made opaque; the device is let go all the same.
        """
        with self._lock:
            if self._stopping:
                return
            self._panel.end()
            with ExitStack() as stack:
                stack.callback(self._preparation.close)
                self._device.close()

    def _may_reuse(self) -> bool:
        """Whether a mask that is due may serve this capture, too."""
        showing = self._panel.showing
        if showing is None or not self._preparation.under_way:
            return False
        return showing.reuse(reusable(self._policy), self.lateness)

    def _rotate(self) -> None:
        self._require_running()
        if self._panel.showing is not None:
            self._require_another()
        # The epoch is on the disk before its mask is on the panel, so none is ever shown twice.
        self._panel.show(self._preparation.take())

    @property
    def _stopping(self) -> bool:
        return self.state[0] == "stopping"

    def _require_running(self) -> None:
        if self._stopping:
            raise NotReadyError("the daemon is stopping")
        if self.state[0] == "calibrating":
            raise CalibratingError

    def _require_another(self) -> None:
        if not self._preparation.renewable:
            raise RotationImpossibleError(
                "the bundle holds one pair only: serve a bundle with two or more to change masks"
            )
