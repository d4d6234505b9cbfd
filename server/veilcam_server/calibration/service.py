"""The camera measured with itself while the daemon runs, one calibration at a time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import ExitStack, suppress
from typing import Any, Protocol, TypeVar

import structlog

from veilcam_client.wire.calibration import (
    CalibrationRecord,
    CalibrationRun,
    CalibrationStatus,
    SceneName,
    SignedCalibration,
    Stage,
)
from veilcam_server.bundles.loader import LoadedBundle
from veilcam_server.bundles.manager import Keyrings
from veilcam_server.calibration import CalibrationError, SigningKey
from veilcam_server.calibration.progress import CancelledError, Run
from veilcam_server.calibration.workshop import Workshop
from veilcam_server.camera.engine import CameraEngine
from veilcam_server.errors import (
    CalibratingError,
    CalibrationImpossibleError,
    NotCalibratingError,
    NotReadyError,
    ProblemError,
)

log = structlog.get_logger()
ResultT = TypeVar("ResultT")


class OnDevice(Protocol):
    """Does work on the device's thread."""

    def __call__(
        self, work: Callable[[], ResultT], *, counted: bool = True
    ) -> Coroutine[Any, Any, ResultT]:
        """Return what ``work`` returns, and raise what it raises."""


class Calibrator:
    """Measures when it is told to. Lives on one event loop.

    Args:
        camera: whose device is measured, and which goes on with what was found.
        keyrings: of which the one in use is opened anew for what was found; None: there are none.
        workshop: that measures; None: this camera cannot be measured.
        signed: the record in use.
        on_device: does work on the device's thread.
        tell: takes every change of a calibration; on any thread.
    """

    def __init__(
        self,
        camera: CameraEngine,
        keyrings: Keyrings | None,
        workshop: Workshop | None,
        signed: SignedCalibration | None,
        *,
        on_device: OnDevice,
        tell: Callable[[CalibrationRun], None],
    ) -> None:
        self._camera, self._keyrings, self._workshop = camera, keyrings, workshop
        self._signed, self._on_device, self._tell = signed, on_device, tell
        self._run: Run | None = None
        self._task: asyncio.Task[None] | None = None
        self._starting = asyncio.Lock()

    @property
    def status(self) -> CalibrationStatus:
        """The record in use, and how the last calibration goes on."""
        return CalibrationStatus(
            signed=self._signed, run=None if self._run is None else self._run.seen
        )

    def require_idle(self) -> None:
        """Raise :class:`CalibratingError` while a calibration is under way."""
        if self._task is not None and not self._task.done():
            raise CalibratingError

    async def start(self, repeats: int) -> CalibrationRun:
        """Begin to measure.

        Args:
            repeats: exposures for one reading.

        Raises:
            CalibrationImpossibleError: this camera cannot be measured, or no record be kept.
            CalibratingError: it is being measured.
            NotReadyError: the daemon is stopping.
        """
        workshop = self._workshop
        if workshop is None:
            raise CalibrationImpossibleError(
                "there is no panel and no sensor to calibrate: this daemon replays a recording"
            )
        async with self._starting:
            self.require_idle()
            if self._camera.state[0] in ("starting", "stopping"):
                raise NotReadyError(f"the daemon is {self._camera.state[0]}")
            try:
                key = await asyncio.to_thread(workshop.open_key)
            except CalibrationError as error:
                raise CalibrationImpossibleError(str(error)) from None
            run = self._run = Run(workshop.exposures(repeats), self._tell)
            self._task = asyncio.create_task(self._calibrate(workshop, run, key, repeats))
        self._tell(run.seen)
        return run.seen

    def presented(self, scene: SceneName) -> CalibrationRun:
        """The scene that is waited for is there.

        Raises:
            NotCalibratingError: no calibration is under way.
            SceneNotWantedError: another scene is waited for, or none.
        """
        run = self._under_way()
        run.presented(scene)
        return run.seen

    async def cancel(self) -> CalibrationRun:
        """End the calibration under way, and wait until the camera is back.

        Raises:
            NotCalibratingError: there is none.
        """
        run = self._under_way()
        await self.close()
        return run.seen

    async def close(self) -> None:
        """Let nothing be under way any more."""
        if self._task is not None and self._run is not None:
            self._run.cancel()
            await asyncio.wait([self._task])

    def _under_way(self) -> Run:
        if self._run is None or self._task is None or self._task.done():
            raise NotCalibratingError
        return self._run

    async def _calibrate(self, workshop: Workshop, run: Run, key: SigningKey, repeats: int) -> None:
        stage: Stage = "done"
        detail: str | None = None
        exclusive = ExitStack()

        def measure() -> CalibrationRecord:
            device = exclusive.enter_context(self._camera.exclusive())
            return workshop.measure(device, run, repeats)

        try:
            record = await self._on_device(measure, counted=False)
            run.check()
            await self._adopt(workshop, record, key)
        except CancelledError:
            stage = "cancelled"
        except Exception as error:
            stage, detail = "failed", str(error)
            if not isinstance(error, (ProblemError, CalibrationError)):
                log.error("defect", error=type(error).__name__, during="calibration")
                detail = "the daemon has a defect: nothing was changed"
        # Why no mask is shown, where none is, the state tells.
        with suppress(Exception):
            await self._on_device(exclusive.close)
        log.info("calibration", outcome=stage, detail=detail)
        run.end(stage, detail)

    async def _adopt(self, workshop: Workshop, record: CalibrationRecord, key: SigningKey) -> None:
        """Keep a record, and go on with it; or raise, and nothing was changed."""
        signed = workshop.sign(record, key)

        async def change(keys: LoadedBundle) -> None:
            await asyncio.to_thread(workshop.keep, signed)
            settle = workshop.settle(signed)
            await self._on_device(lambda: self._camera.adopt(signed, settle, keys.source))

        assert self._keyrings is not None  # noqa: S101 - a camera that can be measured has some
        await self._keyrings.reopen(workshop.opener(signed), change)
        self._signed = signed
