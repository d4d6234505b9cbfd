"""Shutter: frames behind the mask that is shown, and the guard's word for each."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime

from veilcam_client.keys.commitments import calibration_digest
from veilcam_client.wire.calibration import SignedCalibration
from veilcam_client.wire.captures import Exposure as ExposureNote
from veilcam_server.camera.capture import (
    ActiveMask,
    Fence,
    Frame,
    MaskedCapture,
    Provenance,
    check_exposure,
)
from veilcam_server.camera.guard import Guard
from veilcam_server.camera.panel import MaskedPanel
from veilcam_server.devices.base import Device, Light
from veilcam_server.devices.errors import DisplayError, LightError, SaturatedError, SensorError
from veilcam_server.errors import FenceError, PanelNotHidingError, ProblemError, UnsteadyLightError

_MOST_FAILURES = 2
"""Consecutive sensor failures before the camera is marked as failed."""


class Shutter:
    """Exposes behind the mask that is shown. Used by one thread at a time.

    Args:
        panel: panel with the mask.
        guard: guard that vouches for frames.
        shape: shape of an embedding.
    """

    _device: Device
    _fence: Fence
    _calibration: str | None

    def __init__(self, panel: MaskedPanel, guard: Guard, shape: tuple[int, ...]) -> None:
        self._panel, self._guard, self._shape = panel, guard, shape
        self._good = "none yet"
        """The last capture beside which an opaque frame was hidden."""
        self._failures = 0

    def adopt(self, device: Device, fence: Fence, calibration: SignedCalibration | None) -> None:
        """Expose with a calibration from now on; before the first exposure, too.

        Args:
            device: panel and sensor, with the calibration in force.
            fence: times to keep.
            calibration: calibration in force; None: the camera is taken to be nominal.
        """
        self._device, self._fence = device, fence
        self._calibration = None if calibration is None else calibration_digest(calibration)

    def expose(self, active: ActiveMask, begun: float) -> Frame:
        """Expose once under a mask, and count that.

        Args:
            active: mask that is shown.
            begun: time when the request was taken up [s].

        Raises:
            SensorError: the sensor gave no measurement.
            FenceError: it gave one that cannot be trusted.
        """
        shown_at, not_before = time.monotonic(), active.completed_at + self._fence.settle
        taken_at, number = datetime.now(UTC).replace(microsecond=0), active.captures
        # Counted before it begins: a number is never used twice, whatever comes of it.
        active.captures += 1
        try:
            with self._counted():
                exposure = self._device.sensor.capture(not_before, self._fence.timeout)
        except SaturatedError:
            # A panel that is transparent saturates a sensor that is exposed for masks.
            light = self._device.sensor.light(not_before, self._fence.timeout)
            self.vouch(active, light, begun, last=True)
            raise
        self._failures, ended = 0, time.monotonic()
        if self._panel.active is not active:
            raise FenceError("the mask changed during the exposure, which was thrown away")
        check_exposure(exposure, not_before=not_before, ended=ended, shape=self._shape)
        settled = max(0.0, not_before - shown_at)
        return Frame(
            exposure,
            active,
            number,
            taken_at,
            rotation_s=shown_at - begun,
            settle_s=settled,
            capture_s=max(0.0, ended - shown_at - settled),
        )

    def vouch(self, active: ActiveMask, light: Light, begun: float, *, last: bool) -> None:
        """Hold a capture until the guard vouches for it.

        A refusal leaves at a fixed time after the request, so that its latency tells nothing.

        Args:
            active: mask of the capture.
            light: light of the capture, the last that was begun under the mask.
            begun: time when the request was taken up [s].
            last: True: no earlier opaque frame will do.

        Raises:
            PanelNotHidingError: the panel does not hide the scene, and was made opaque.
            UnsteadyLightError: the light changed, so that nothing tells whether it does.
            SensorError, DisplayError: the guard got no frame.
        """
        name = f"{active.captures - 1} of epoch {active.epoch.name}"
        try:
            with self._counted():
                if self._guard.vouch(active.epoch.mask.levels, light, last=last):
                    self._good = name
            return
        except DisplayError as error:
            self._panel.fail(error)
            raise
        except PanelNotHidingError:
            accusation = PanelNotHidingError(
                "the panel does not hide the scene: it was reset and is tested; the last capture "
                f"known to be good is {self._good}"
            )
            self._panel.accuse(accusation)
            refusal: ProblemError = accusation
        except UnsteadyLightError as error:
            refusal = error
            active.completed_at = self._guard.completed_at
        time.sleep(max(0.0, begun + self._guard.refusal - time.monotonic()))
        raise refusal from None

    def capture(self, frame: Frame, tested: float) -> MaskedCapture:
        """Return a frame that the guard vouched for as a capture, of which nothing leaves.

        Args:
            frame: frame under the mask that is shown.
            tested: time since the panel passed its self test [s].
        """
        scenes, active, exposure = self._device.scenes, frame.active, frame.exposure
        scene = None if scenes is None else scenes.seen
        if scenes is not None:
            scenes.advance()
        note = ExposureNote(
            started_after_shown_s=exposure.started_at - active.completed_at,
            settle_s=self._fence.settle,
            duration_s=exposure.ended_at - exposure.started_at,
        )
        provenance = Provenance(active.epoch.commitment, tested, self._calibration)
        return MaskedCapture(frame, provenance, note, scene)

    @contextmanager
    def _counted(self) -> Iterator[None]:
        """Give a sensor up that fails again, until a self test has passed."""
        try:
            yield
        except LightError:
            raise
        except SensorError as error:
            self._failures += 1
            if self._failures >= _MOST_FAILURES:
                self._panel.give_up(error)
            raise
