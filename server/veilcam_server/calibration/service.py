"""Calibrations of one camera, one at a time, over the API or from a terminal, and their records."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Coroutine
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, TypeVar

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
from veilcam_server.calibration.loading import (
    check_record,
    geometry_of,
    panel_tab,
    record_path,
    settle_time,
    source_opener,
)
from veilcam_server.calibration.measurements import Budget
from veilcam_server.calibration.procedure import Calibrated, calibrate
from veilcam_server.calibration.record import calibration_store, sign_record
from veilcam_server.calibration.rig import CalibrationScene, Geometry
from veilcam_server.calibration.run import CancelledError, Run
from veilcam_server.camera.engine import CameraEngine, Publish
from veilcam_server.devices.base import Device
from veilcam_server.errors import (
    CalibrationError,
    NotReadyError,
    ProblemError,
)
from veilcam_server.settings import Settings
from veilcam_server.system.logs import log_defect
from veilcam_training.bundle import Bundle

log = structlog.get_logger()
ResultT = TypeVar("ResultT")

LONGEST = 3.0
"""Settling may take so many times what the daemon would grant it without a calibration."""
_NO_CAMERA = "there is no panel and no sensor to calibrate: this daemon replays a recording"


class OnDevice(Protocol):
    """Does work on the device's thread."""

    def __call__(
        self, work: Callable[[], ResultT], *, counted: bool = True
    ) -> Coroutine[Any, Any, ResultT]:
        """Return what ``work`` returns, and raise what it raises."""


@dataclass(frozen=True, slots=True)
class Served:
    """A camera that captures are taken with between its calibrations.

    Attributes:
        camera: camera whose device is measured, and which goes on with the result.
        bundles: bundles, of which the one in use is opened anew for the result.
        on_device: does work on the device's thread.
        publish: takes every change of a calibration; on any thread.
    """

    camera: CameraEngine
    bundles: BundleManager
    on_device: OnDevice
    publish: Publish


class CalibrationService:
    """Measures a camera with itself, and keeps what was found.

    Whoever has the device to himself calls :meth:`begin`, :meth:`measure`, :meth:`sign` and
    :meth:`write`, which block. A daemon lives with the rest on one event loop.

    Args:
        settings: checked.
        bundle: bundle whose camera it is; None: a recording is replayed, and there is no camera.
        key: key of the device, which signs records; None: as above.
        signed: the record in use.
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
        """Return a calibration to measure.

        Args:
            repeats: exposures for one measurement.
            report: takes every change of it.

        Raises:
            CalibrationError: this camera cannot be measured, or no record be kept.
        """
        budget = Budget(repeats=repeats)
        run = Run(budget, budget.captures(self._geometry), report)
        # What cannot be written should not be found out minutes later.
        folder = record_path(self._settings).parent
        if not os.access(folder, os.W_OK):
            raise CalibrationError(f"no calibration can be written into {folder}: check it")
        self._run = run
        report(run.state)
        return run

    def measure(self, device: Device, run: Run) -> Calibrated:
        """Measure a device; it takes minutes.

        Raises:
            CancelledError: somebody wants it to end.
            CalibrationError: the camera, its light or the fit is not good enough.
            DeviceError, FenceError: panel or sensor failed.
        """
        settings, fresh, scenes = self._settings, self._bundle.fresh, device.scenes

        def set_scene(scene: CalibrationScene) -> None:
            if scenes is None:
                # Somebody stands before the camera now, maybe for minutes.
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
        """Vouch for a record; raises :class:`CalibrationError` if it is of another camera."""
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
        """The record in use, and how the last calibration goes on."""
        return CalibrationStatus(
            signed=self._signed, run=None if self._run is None else self._run.state
        )

    def require_idle(self) -> None:
        """Raise :class:`NotReadyError` while a calibration is under way."""
        if self._task is not None and not self._task.done():
            raise NotReadyError("the camera is being calibrated: see GET /v1/calibration")

    async def start(self, repeats: int) -> CalibrationRun:
        """Begin to measure the camera that is served.

        Args:
            repeats: exposures for one measurement.

        Raises:
            CalibrationError: this camera cannot be measured, or no record be kept.
            NotReadyError: it is being measured, or the daemon is stopping.
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
        """Go on: the scene that is waited for is there.

        Raises:
            ProblemError: no calibration is under way, or another scene is waited for.
        """
        return self._under_way().confirm(scene)

    async def cancel(self) -> CalibrationRun:
        """End the calibration under way, and wait until the camera is back.

        Raises:
            ProblemError: there is none.
        """
        run = self._under_way()
        await self.close()
        return run.state

    async def close(self) -> None:
        """Let nothing be under way any more."""
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
        # Why no mask is shown, where none is, the state tells.
        with suppress(Exception):
            await served.on_device(exclusive.close)
        log.info("calibration", outcome=stage, detail=detail)
        run.enter(stage, detail=detail)

    async def _adopt(self, served: Served, record: CalibrationRecord) -> None:
        """Keep a record, and go on with it; or raise, and nothing was changed."""
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
