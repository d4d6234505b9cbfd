"""Procedure of a calibration, and its progress."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from veilcam_client.wire.calibration import CalibrationRecord, CalibrationRun, SceneName, Stage
from veilcam_optics.transfer.tables import Reach
from veilcam_server.calibration.fit import CalibrationResult, fit, make_record
from veilcam_server.calibration.measurements import Budget, measure
from veilcam_server.calibration.rig import CalibrationScene, Geometry, Rig
from veilcam_server.camera.capture import Fence
from veilcam_server.devices.base import Device
from veilcam_server.errors import CalibrationError, ProblemError

PATIENCE = 600.0
"""Longest wait for a person who sets a scene, during which captures wait [s]."""
_REPORTS = 20
"""Greatest number of reports of exposures."""


class CancelledError(Exception):
    """Calibration was cancelled."""


class Run:
    """Progress of one calibration. Any thread may follow, confirm and cancel it.

    Args:
        budget: number of measurements.
        total: number of exposures.
        report: function that takes every change, on the thread that makes it. It may confirm a
            scene at once.
        patience: longest wait for a scene [s].
    """

    def __init__(
        self,
        budget: Budget,
        total: int,
        report: Callable[[CalibrationRun], None],
        *,
        patience: float = PATIENCE,
    ) -> None:
        self.budget = budget
        self._report, self._patience = report, patience
        self._every = max(1, total // _REPORTS)
        self._lock = threading.RLock()
        self._cancelled = threading.Event()
        self._confirmed: queue.SimpleQueue[None] = queue.SimpleQueue()
        self.state = CalibrationRun(
            stage="measuring", scene=None, instruction=None, exposures=0, total=total, detail=None
        )
        """State of the calibration."""

    def confirm(self, scene: SceneName) -> CalibrationRun:
        """Go on with a scene; raises :class:`ProblemError` if another one is expected."""
        with self._lock:
            wanted = self.state.scene if self.state.stage == "waiting" else None
            if scene != wanted:
                what = "no scene is" if wanted is None else f"the scene {wanted!r} is"
                raise ProblemError(
                    "conflict", f"{what} waited for, not {scene!r}: see GET /v1/calibration"
                )
            self.enter("measuring", scene)
        self._confirmed.put(None)
        return self.state

    def wait_for(self, scene: CalibrationScene) -> None:
        """Wait until a scene is confirmed.

        Raises:
            CancelledError: the calibration was cancelled.
            CalibrationError: nobody confirmed the scene in time.
        """
        self.enter("waiting", scene.name, instruction=scene.instruction)
        try:
            self._confirmed.get(timeout=self._patience)
        except queue.Empty:
            raise CalibrationError(
                f"nobody said within {self._patience:g} s that the {scene.name} scene is there: "
                "start again"
            ) from None
        self.check()

    def advance(self) -> None:
        """Count one more exposure; raises :class:`CancelledError` after :meth:`cancel`."""
        with self._lock:
            exposures = self.state.exposures + 1
            self.state = self.state.model_copy(update={"exposures": exposures})
            if exposures % self._every == 0:
                self._report(self.state)
        self.check()

    def cancel(self) -> None:
        """End the calibration at its next exposure, evaluation or wait."""
        self._cancelled.set()
        self._confirmed.put(None)

    def check(self) -> None:
        """Raise :class:`CancelledError` after :meth:`cancel`."""
        if self._cancelled.is_set():
            raise CancelledError

    def enter(
        self,
        stage: Stage,
        scene: SceneName | None = None,
        *,
        instruction: str | None = None,
        detail: str | None = None,
    ) -> None:
        """Begin another stage, and report it."""
        with self._lock:
            self.state = self.state.model_copy(
                update={
                    "stage": stage,
                    "scene": scene,
                    "instruction": instruction,
                    "detail": detail,
                }
            )
            self._report(self.state)


@dataclass(frozen=True, eq=False, slots=True)
class Calibrated:
    """Record of a calibration, and the result behind it."""

    record: CalibrationRecord
    result: CalibrationResult


def calibrate(
    device: Device,
    geometry: Geometry,
    set_scene: Callable[[CalibrationScene], None],
    *,
    longest: float,
    exposure: float,
    tab: str | None = None,
    reach: Reach = Reach(),  # noqa: B008 - immutable
    timeout: float = 5.0,
    budget: Budget = Budget(),  # noqa: B008 - immutable
    advance: Callable[[], None] = lambda: None,
    check: Callable[[], None] = lambda: None,
    fitting: Callable[[], None] = lambda: None,
    clock: Callable[[], float] = time.monotonic,
) -> Calibrated:
    """Calibrate a camera with its own sensor. The panel is opaque afterwards, also after an error.

    Args:
        device: panel and sensor, which stay open.
        geometry: the nominal camera.
        set_scene: function that returns once a scene is in front of the camera.
        longest: longest time that the panel's settling may take [s].
        exposure: exposure of measurements, for the record [s].
        tab: tab of the panel, for the record.
        reach: reach of interference that decoders assume.
        timeout: longest wait for one measurement [s].
        budget: number of measurements of each kind.
        advance: function that is called after each of ``budget.captures(geometry)`` exposures. Its
            exception ends the calibration, as that of ``check`` does.
        check: function that is called before each evaluation of a fit.
        fitting: function that is called after the last exposure, once the panel is opaque.
        clock: monotonic time [s].

    Raises:
        CalibrationError: the camera, its light or the fit is not good enough; the text has a
            remedy.
        DeviceError, FenceError: panel or sensor failed.
    """

    def rig(settle: float) -> Rig:
        return Rig(
            device,
            geometry.camera,
            geometry.embedding.shape,
            fence=Fence(settle, timeout),
            repeats=budget.repeats,
            advance=advance,
            clock=clock,
        )

    try:
        measured = measure(rig, geometry, set_scene, longest=longest, reach=reach, budget=budget)
    finally:
        device.display.blank()
    fitting()
    found = fit(measured, geometry, reach=reach, patterns=budget.patterns, check=check)
    record = make_record(found, device, exposure=exposure, tab=tab, geometry=geometry.digest)
    return Calibrated(record, found)
