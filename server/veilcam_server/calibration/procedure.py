"""The whole of a calibration: three scenes, and what follows from each."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from veilcam_client.wire.calibration import CalibrationRecord
from veilcam_optics.transfer.tables import Reach
from veilcam_server.calibration.fit import fit
from veilcam_server.calibration.measurements import Budget, measure
from veilcam_server.calibration.result import CalibrationResult, make_record
from veilcam_server.calibration.rig import CalibrationScene, Geometry, Rig
from veilcam_server.camera.capture import Fence
from veilcam_server.devices.base import Device


@dataclass(frozen=True, eq=False, slots=True)
class Calibrated:
    """The record, and the curves that it was made from."""

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
    """Measure a camera with itself. The panel is opaque afterwards, come what may.

    Args:
        device: panel and sensor; it is not closed here.
        geometry: the nominal camera.
        set_scene: brings a scene before the camera and returns once it is there.
        longest: longest time that the panel's settling may take [s].
        exposure: exposure of measurements, for the record [s].
        tab: tab of the panel, for the record.
        reach: reach of interference that decoders assume.
        timeout: longest wait for one measurement [s].
        budget: number of measurements of each kind.
        advance: called after each of ``budget.captures(geometry)`` exposures; what it raises ends
            the calibration, as what ``check`` does.
        check: called before each evaluation of a fit.
        fitting: called once everything is read; the panel is opaque from then on.
        clock: monotonic time [s].

    Raises:
        CalibrationError: the camera, its light or the fit is not good enough, and what to do.
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
