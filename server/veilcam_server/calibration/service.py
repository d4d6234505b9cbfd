"""Service of calibrations: one at a time, over the API or from a terminal, and their records."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial

import structlog

from veilcam_client.keys.envelopes import Signer
from veilcam_client.wire.calibration import (
    CalibrationRecord,
    CalibrationRun,
    CalibrationStatus,
    SceneName,
    SignedCalibration,
    Stage,
)
from veilcam_client.wire.events import CalibrationChanged
from veilcam_optics.transfer.tables import Reach
from veilcam_server.bundles.loader import LoadedBundle
from veilcam_server.bundles.manager import BundleManager
from veilcam_server.calibration.measurements import Budget
from veilcam_server.calibration.procedure import Calibrated, CancelledError, Run, calibrate
from veilcam_server.calibration.record import (
    calibration_store,
    check_record,
    geometry_of,
    panel_tab,
    record_path,
    settle_time,
    sign_record,
    source_opener,
)
from veilcam_server.calibration.rig import CalibrationScene, Geometry
from veilcam_server.camera.engine import CameraEngine, OnDevice, Publish
from veilcam_server.devices.base import Device
from veilcam_server.errors import CalibrationError, NotReadyError, ProblemError
from veilcam_server.settings import Settings
from veilcam_server.system.logs import log_defect
from veilcam_training.bundle import Bundle

log = structlog.get_logger()

LONGEST = 3.0
"""Longest settling time, over that of the settings."""
_NO_CAMERA = "there is no panel and no sensor to calibrate: this daemon replays a recording"


@dataclass(frozen=True, slots=True)
class Served:
    """Parts of the daemon that a calibration uses.

    Attributes:
        camera: camera that is calibrated, and goes on with the result.
        bundles: bundles, of which the one in use is opened again with the result.
        on_device: function that does work on the device's thread.
        publish: function that takes every change of a calibration, on any thread.
    """

    camera: CameraEngine
    bundles: BundleManager
    on_device: OnDevice
    publish: Publish


class CalibrationService:
    """Calibrations of a camera, and the record in use.

    :meth:`begin`, :meth:`measure`, :meth:`sign` and :meth:`write` block, for a program that owns
    the device. The other methods are for the event loop of a daemon.

    Args:
        settings: settings of the daemon.
        bundle: bundle of the camera; None where a recording is replayed.
        key: key of the device, which signs records; None where a recording is replayed.
        signed: record in use.
    """

    def __init__(
        self,
        settings: Settings,
        bundle: Bundle | None,
        key: Signer | None,
        signed: SignedCalibration | None = None,
    ) -> None:
        self._settings, self._given, self._key, self._signed = settings, bundle, key, signed
        self._served: Served | None = None
        self._run: Run | None = None
        self._task: asyncio.Task[None] | None = None
        self._starting = asyncio.Lock()

    def begin(self, repeats: int, report: Callable[[CalibrationRun], None]) -> Run:
        """Return a new calibration, before its first measurement.

        Args:
            repeats: exposures for one measurement.
            report: function that takes every change.

        Raises:
            CalibrationError: this camera cannot be calibrated, or no record can be written.
        """
        budget = Budget(repeats=repeats)
        run = Run(budget, budget.captures(self._geometry), report)
        # Checked before minutes of measurements.
        folder = record_path(self._settings).parent
        if not os.access(folder, os.W_OK):
            raise CalibrationError(f"no calibration can be written into {folder}: check it")
        self._run = run
        report(run.state)
        return run

    def measure(self, device: Device, run: Run) -> Calibrated:
        """Calibrate a device, which takes minutes.

        Raises:
            CancelledError: the calibration was cancelled.
            CalibrationError: the camera, its light or the fit is not good enough.
            DeviceError, FenceError: panel or sensor failed.
        """
        settings, fresh, scenes = self._settings, self._bundle.fresh, device.scenes

        def set_scene(scene: CalibrationScene) -> None:
            if scenes is None:
                # A person may be in front of the camera for minutes.
                device.display.blank()
                run.wait_for(scene)
            else:
                scenes.hold(scene.image)
                run.enter("measuring", scene.name)

        try:
            return calibrate(
                device,
                self._geometry,
                set_scene,
                longest=LONGEST * settings.settle,
                exposure=settings.exposure,
                tab=panel_tab(settings),
                reach=fresh.reach if fresh else Reach(),
                timeout=settings.capture_timeout,
                budget=run.budget,
                advance=run.advance,
                check=run.check,
                fitting=lambda: run.enter("fitting"),
            )
        finally:
            if scenes is not None:
                scenes.hold(None)

    def sign(self, record: CalibrationRecord) -> SignedCalibration:
        """Sign a record; raises :class:`CalibrationError` if it is of another camera."""
        if self._key is None:
            raise CalibrationError(_NO_CAMERA)
        check_record(record, self._settings, self._bundle)
        return sign_record(record, self._key)

    def write(self, signed: SignedCalibration) -> None:
        """Let the next daemon begin with a record; raises :class:`StorageError`."""
        calibration_store(record_path(self._settings)).change(lambda _: signed)

    def serve(self, served: Served) -> None:
        """Take the camera that :meth:`start` measures."""
        self._served = served

    @property
    def status(self) -> CalibrationStatus:
        """Record in use, and state of the last calibration."""
        return CalibrationStatus(
            signed=self._signed, run=None if self._run is None else self._run.state
        )

    def require_idle(self) -> None:
        """Raise :class:`NotReadyError` while a calibration is under way."""
        if self._task is not None and not self._task.done():
            raise NotReadyError("the camera is being calibrated: see GET /v1/calibration")

    async def start(self, repeats: int) -> CalibrationRun:
        """Begin to calibrate the camera that is served.

        Args:
            repeats: exposures for one measurement.

        Raises:
            CalibrationError: this camera cannot be calibrated, or no record can be written.
            NotReadyError: a calibration is under way, or the daemon is stopping.
        """
        served = self._served
        if served is None:
            raise CalibrationError(_NO_CAMERA)

        def report(state: CalibrationRun) -> None:
            served.publish(partial(CalibrationChanged, run=state))

        async with self._starting:
            self.require_idle()
            if (state := served.camera.state[0]) in ("starting", "stopping"):
                raise NotReadyError(f"the daemon is {state}")
            run = await asyncio.to_thread(self.begin, repeats, report)
            self._task = asyncio.create_task(self._calibrate(served, run))
        return run.state

    def confirm(self, scene: SceneName) -> CalibrationRun:
        """Confirm a scene, so that the calibration goes on.

        Raises:
            ProblemError: no calibration is under way, or another scene is expected.
        """
        return self._under_way().confirm(scene)

    async def cancel(self) -> CalibrationRun:
        """Cancel the calibration under way, and wait until the camera is back.

        Raises:
            ProblemError: no calibration is under way.
        """
        run = self._under_way()
        await self.close()
        return run.state

    async def close(self) -> None:
        """Cancel any calibration, and wait for its end."""
        if self._task is not None and self._run is not None:
            self._run.cancel()
            await asyncio.wait([self._task])

    def _under_way(self) -> Run:
        if self._run is None or self._task is None or self._task.done():
            raise ProblemError(
                "conflict", "no calibration is under way: begin one with POST /v1/calibration"
            )
        return self._run

    async def _calibrate(self, served: Served, run: Run) -> None:
        stage: Stage = "done"
        detail: str | None = None
        exclusive = ExitStack()

        def measure() -> CalibrationRecord:
            device = exclusive.enter_context(served.camera.exclusive())
            return self.measure(device, run).record

        try:
            record = await served.on_device(measure, counted=False)
            run.check()
            await self._adopt(served, record)
        except CancelledError:
            stage = "cancelled"
        except Exception as error:
            stage, detail = "failed", str(error)
            if not isinstance(error, ProblemError):
                log_defect(error, during="calibration")
                detail = "the daemon has a defect: nothing was changed"
        # The state tells why no mask is shown.
        with suppress(Exception):
            await served.on_device(exclusive.close)
        log.info("calibration", outcome=stage, detail=detail)
        run.enter(stage, detail=detail)

    async def _adopt(self, served: Served, record: CalibrationRecord) -> None:
        """Write a record and use it, or raise without a change."""
        signed = self.sign(record)
        settle = settle_time(self._settings, signed)

        async def change(keys: LoadedBundle) -> None:
            await asyncio.to_thread(self.write, signed)
            await served.on_device(lambda: served.camera.adopt(signed, settle, keys.source))

        await served.bundles.reopen(source_opener(self._settings, signed), change)
        self._signed = signed

    @property
    def _bundle(self) -> Bundle:
        if self._given is None:
            raise CalibrationError(_NO_CAMERA)
        return self._given

    @property
    def _geometry(self) -> Geometry:
        return geometry_of(self._bundle)
