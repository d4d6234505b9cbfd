"""One calibration under way: how far it is, and what it waits for."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

from veilcam_client.wire.calibration import CalibrationRun, SceneName, Stage
from veilcam_server.calibration.measurements import Budget
from veilcam_server.calibration.rig import CalibrationScene
from veilcam_server.errors import CalibrationError, ProblemError

PATIENCE = 600.0
"""Longest wait for somebody to set a scene; the camera takes no captures meanwhile [s]."""
_REPORTS = 20
"""How often, at most, exposures are reported."""


class CancelledError(Exception):
    """Somebody wants it to end."""


class Run:
    """One calibration: measured on one thread, followed and answered on that or another.

    Args:
        budget: number of measurements.
        total: exposures that it takes.
        report: takes every change worth telling, on the thread that makes it, and may confirm a
            scene on the spot.
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
        """How far it is."""

    def confirm(self, scene: SceneName) -> CalibrationRun:
        """Go on, as a scene is set; raises :class:`ProblemError` if it is another one."""
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
            CancelledError: it never will be.
            CalibrationError: it was not in time.
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
        """One more exposure was taken; raises :class:`CancelledError` if it is to end."""
        with self._lock:
            exposures = self.state.exposures + 1
            self.state = self.state.model_copy(update={"exposures": exposures})
            if exposures % self._every == 0:
                self._report(self.state)
        self.check()

    def cancel(self) -> None:
        """Let the next exposure, fit or wait end it."""
        self._cancelled.set()
        self._confirmed.put(None)

    def check(self) -> None:
        """Raise :class:`CancelledError` if it is to end."""
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
