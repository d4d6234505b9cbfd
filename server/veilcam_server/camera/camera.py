"""The engine: one panel, one sensor, one lock, and the rule that no measurement mixes two masks.

Mask, reader and epoch change as one. A capture is exposed wholly under one settled mask, which is
checked before and after (the fence), or it is an error. No capture is taken unless a self test has
proven that the panel hides the scene (``panel.py``), and none leaves without an opaque frame that
shows that it still does (``guard.py``).
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from veilcam_client.wire.calibration import SignedCalibration
from veilcam_client.wire.rotation import Rotation, RotationOff, RotationPolicy
from veilcam_server.camera.budget import masks_spent
from veilcam_server.camera.capture import ActiveMask, Fence, Lateness, MaskedCapture
from veilcam_server.camera.engine import Condition, Publish
from veilcam_server.camera.epochs import Epoch, Preparation
from veilcam_server.camera.guard import Guard
from veilcam_server.camera.panel import MaskedPanel, MaskRotation
from veilcam_server.camera.self_test import Checks, SelfTest, SelfTestStatus
from veilcam_server.camera.shutter import Shutter
from veilcam_server.devices.base import Device
from veilcam_server.devices.corrected import calibrated
from veilcam_server.devices.errors import DisplayError
from veilcam_server.devices.reopening import Health, stamped
from veilcam_server.errors import NotReadyError, ProblemError, RotationImpossibleError
from veilcam_server.masks.source import MaskSource

_MARGIN = 15.0
"""What a capture may take beyond its timeout: a camera is closed and opened again [s]."""


class MaskedCamera:
    """Takes captures and changes masks, one thing at a time. Blocks: call it from a thread.

    Args:
        device: panel and sensor.
        preparation: makes epochs ready; closed with this.
        shape: shape of an embedding.
        test: proves that the panel hides the scene.
        fence: times to keep.
        policy: policy of mask changes.
        checks: periods of self test and guard.
        calibration: calibration that corrects measurements.

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
        checks: Checks = Checks(),  # noqa: B008 - immutable
        calibration: SignedCalibration | None = None,
    ) -> None:
        self._health = Health(fence.settle + fence.timeout + _MARGIN)
        self._bare = stamped(device, self._health)
        self.preparation = preparation
        """What makes epochs ready."""
        self._device = calibrated(self._bare, calibration)
        self._fence, self._budget = fence, preparation.budget
        self._self_test = SelfTestStatus(test, self._device, fence, every=checks.test_every)
        self._guard = Guard(self._bare, fence, steps=checks.steps, every=checks.guard_every)
        self._panel = MaskedPanel(self._device.display, preparation, self._self_test, self._guard)
        self._shutter = Shutter(self._panel, self._guard, shape)
        self._shutter.adopt(self._device, fence, calibration)
        self._rotation = MaskRotation(self._panel, preparation, policy)
        self._lock = threading.Lock()
        self._resting: str | None = None

    def listen(self, publish: Publish) -> None:
        """Publish every new state and mask, while the device is busy."""
        self._panel.publish = publish

    @property
    def state(self) -> Condition:
        """State of the camera."""
        return self._panel.state

    def healthy(self) -> bool:
        """Return whether panel and camera still answer."""
        return self._health.healthy()

    @property
    def policy(self) -> RotationPolicy:
        """Policy of mask changes; raises RotationImpossibleError where there is no other mask."""
        return self._rotation.policy

    @policy.setter
    def policy(self, policy: RotationPolicy) -> None:
        self._rotation.policy = policy

    @property
    def lateness(self) -> Lateness:
        """Count of masks that were not ready in time."""
        return self._rotation.lateness

    @property
    def present(self) -> tuple[str | None, int]:
        """Name of the epoch shown (None: no mask) and the captures taken under it."""
        return self._rotation.present

    def rotation(self) -> Rotation:
        """Return the policy, the present epoch, and whether the next one is ready."""
        return self._rotation.status()

    def first_of(self, source: MaskSource) -> Epoch:
        """Prepare a mask of another source; raises as :meth:`Preparation.first_of`."""
        return self.preparation.first_of(source)

    def renew(self) -> None:
        """Prepare the next mask anew, as another form or other receivers hold from it on."""
        with self._lock:
            self.preparation.discard()
            if self._panel.active is not None and self.preparation.renewable:
                self.preparation.begin()

    def await_next(self) -> None:
        """Wait until no mask is being prepared."""
        self.preparation.wait()

    def due_in(self) -> float:
        """Seconds until the mask must change, or be written again; inf when nothing is planned."""
        return 0.0 if self._panel.covered else self._rotation.due_in()

    def test_due_in(self) -> float:
        """Seconds until the panel must be tested, or tested again after a test that failed."""
        if self.state.state in ("stopping", "calibrating", "off"):
            return math.inf
        return self._panel.proven_for()

    def test_if_due(self) -> None:
        """Test the panel if that is due, and show the mask again; raises as :meth:`rotate`.

        From the states ``safe`` and ``degraded`` this is the way back, and shows another mask; or
        it is tried again to make the panel opaque, if that is wanted.
        """
        with self._lock:
            if self._resting is not None:
                self._rest(self._resting)
            elif self._panel.active is None:
                self._rotate()
            else:
                self._panel.test()

    def rest(self, reason: str) -> None:
        """Make the panel opaque, and take no capture and test nothing until :meth:`wake`.

        While somebody has the device for himself, that begins when he gives it back.

        Args:
            reason: reason for whoever asks for a capture.

        Raises:
            DisplayError: the panel does not become opaque; :meth:`test_if_due` tries it again.
        """
        with self._lock:
            self._resting = reason
            if self.state.state not in ("stopping", "calibrating"):
                self._rest(reason)

    def wake(self) -> None:
        """Show a mask again after :meth:`rest`; nothing where there was none.

        Raises:
            SelfTestError, SensorError, FenceError, DisplayError: as :meth:`rotate`;
                :meth:`test_if_due` tries it again.
        """
        with self._lock:
            if self._resting is None:
                return
            self._resting = None
            if self.state.state not in ("stopping", "calibrating"):
                self._rotate()

    @contextmanager
    def exclusive(self) -> Iterator[Device]:
        """Have the device as it is, without any calibration, on whatever thread.

        No mask is shown and no capture taken within. At the end the panel is tested and a mask
        shown; where that fails, the state says why, and it is tried again as after any other
        failure.

        Raises:
            NotReadyError: somebody else has it, the camera does not look, or the daemon is
                stopping.
            SelfTestError, SensorError, FenceError, DisplayError: at the end, as
                :meth:`rotate`.
        """
        with self._lock:
            self._require_running()
            self._panel.suspend()
        try:
            self._bare.display.blank()
            yield self._bare
        finally:
            self._take_back()

    def adopt(
        self,
        calibration: SignedCalibration,
        settle: float,
        source: MaskSource,
    ) -> None:
        """Within :meth:`exclusive`: go on with another calibration.

        Args:
            calibration: calibration that corrects measurements.
            settle: settling time of the panel [s].
            source: source whose readers are made for that calibration.
        """
        with self._lock:
            self._device = calibrated(self._bare, calibration)
            self._fence = self._guard.fence = Fence(settle, self._fence.timeout)
            self._shutter.adopt(self._device, self._fence, calibration)
            self.preparation.serve(source)

    def rotate(self) -> None:
        """Show the first mask, or another one now; from any state this is the way to ``ready``.

        Waits for the next mask to be ready, and tests the panel first if that is due.

        Raises:
            SelfTestError: the panel is not proven to hide the scene, and was made opaque.
            SensorError, FenceError: the sensor did not see whether it does.
            RotationImpossibleError: there is no other mask.
            DisplayError: the panel did not take it; the mask shown before is back if possible,
                else the state is ``safe``.
        """
        with self._lock:
            self._rotate()

    def change_source(self, source: MaskSource, first: Epoch) -> None:
        """Show a mask of another source: from then on masks and their readers come from there.

        Args:
            source: source for a camera and an embedding like these.
            first: first epoch of it, prepared by this camera; retired unless it is shown.

        Raises:
            RotationImpossibleError: the policy needs another mask, and the source has one only.
            NotReadyError: who receives has changed since ``first`` was prepared, and another one
                takes too long.
            SelfTestError, SensorError, FenceError, DisplayError: as :meth:`rotate`; the source
                before goes on.
        """
        with self._lock, first.retired_on_failure():
            if not (isinstance(self.policy, RotationOff) or source.renewable):
                raise RotationImpossibleError(
                    "this bundle holds one mask only: turn the rotation of masks off first"
                )
            self._require_running()
            if not self.preparation.is_current(first):
                # Who receives has changed since, and that holds from the next epoch on: this one.
                first.retire()
                first = self.preparation.first_of(source)
            with first.retired_on_failure():
                self._panel.show(first, source)

    def rotate_if_due(self) -> None:
        """Show another mask if the policy wants it and one is ready, or the present one again.

        Raises as :meth:`rotate`.
        """
        with self._lock:
            if self._rotation.due_in() > 0:
                self._panel.uncover()
            elif not self.preparation.under_way:
                self._rotate()

    def capture(self, *, release: bool) -> MaskedCapture:
        """Take one measurement under one mask.

        If the mask is due and the next is not ready, what the policy says is done: this capture
        reuses the mask, or it waits. Where the mask may release nothing more, another one is waited
        for whatever the policy says.

        Args:
            release: True: the embedding will leave; it is counted then, before this returns.

        Returns:
            The capture; whoever has it calls ``done`` at last.

        Raises:
            NotReadyError: no mask is shown, or the panel is not proven to hide the scene.
            SensorError: the sensor gave no measurement.
            FenceError: it gave one that cannot be trusted.
            PanelNotHidingError: the panel does not hide the scene, and was made opaque.
            UnsteadyLightError: the light changed, so that nothing tells whether it does.
            RotationImpossibleError, DisplayError: the mask was due to change and could not; it is
                not used beyond what the policy allows.
            ProblemError: the embedding may not leave.
            StorageError: that it leaves cannot be made durable, so it stays.
        """
        with self._lock:
            begun = time.monotonic()
            self._require_running()
            if self._rotation.due_in() <= 0 and not self._rotation.may_reuse():
                self._rotate()
            if release:
                self._require_releasing()
            self._panel.test()
            self._panel.uncover()
            active = self._panel.active
            if active is None:
                raise NotReadyError(self.state.detail or "no mask is shown yet: try again")
            active.epoch.hold()
            try:
                frame = self._shutter.expose(active, begun)
                last = self._rotation.due_in() <= 0
                self._shutter.vouch(active, frame.exposure.light, begun, last=last)
                captured = self._shutter.capture(frame, self._self_test.age)
                if release and active.epoch.form != "none":
                    self._budget.spend(active.epoch.mask, active.epoch.form)
                    captured.form = active.epoch.form
                return captured
            except BaseException:
                active.epoch.let_go()
                raise

    def stop(self) -> None:
        """Stop the sensor, show opaque and let go; waits for a capture that is under way.

        Raises:
            DisplayError: the panel could not be made opaque; the device is let go all the same.
        """
        with self._lock:
            if self.state.state == "stopping":
                return
            self._panel.end()
            with ExitStack() as stack:
                stack.callback(self.preparation.close)
                self._device.close()

    def _take_back(self) -> None:
        with self._lock:
            if self.state.state != "calibrating":
                return
            self._self_test.adopt(self._device, self._fence)
            if self._resting is not None:
                self._rest(self._resting)
                return
            try:
                self._panel.show(self.preparation.take())
            finally:
                self._panel.strand()

    def _require_releasing(self) -> None:
        """Have a mask shown behind which an embedding may leave; another one if need be."""
        active = self._panel.active
        if active is None:
            return
        # Who was removed receives nothing more, also where the mask does not change by itself.
        if self._refusal(active) is None and self.preparation.is_current(active.epoch):
            return
        if self.preparation.spent:
            raise masks_spent()
        # The same mask again, if there is but one: under other terms it may release.
        self._panel.show(self.preparation.take())
        shown = self._panel.active
        if shown is not None and (error := self._refusal(shown)) is not None:
            raise error

    def _refusal(self, active: ActiveMask) -> ProblemError | None:
        epoch = active.epoch
        return self._budget.refusal(epoch.mask, epoch.form, receives=epoch.sealer is not None)

    def _rotate(self) -> None:
        self._require_running()
        if self._panel.active is not None:
            self._rotation.require_another()
        self._panel.show(self.preparation.take())

    def _rest(self, reason: str) -> None:
        self._panel.rest(reason)
        if self.state.state != "off":
            raise DisplayError(self.state.detail or "", remedy=self.state.remedy)

    def _require_running(self) -> None:
        if self.state.state == "stopping":
            raise NotReadyError("the daemon is stopping")
        if self.state.state == "calibrating":
            raise NotReadyError("the camera is being calibrated: see GET /v1/calibration")
        if self._resting is not None:
            raise ProblemError("not_looking", self._resting)
