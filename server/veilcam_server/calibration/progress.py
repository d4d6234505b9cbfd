"""One calibration as it goes on: what others see of it, and what they may say to it."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

from veilcam_client.wire.calibration import CalibrationRun, SceneName, Stage
from veilcam_server.calibration import CalibrationError, CalibrationScene
from veilcam_server.devices.simulated.scenes import Scenes
from veilcam_server.errors import SceneNotWantedError

PATIENCE = 600.0
"""Longest wait for somebody to hold up a scene; the camera takes no captures meanwhile [s]."""
_TOLD = 20
"""How often, at most, it tells of exposures."""


class CancelledError(Exception):
    """Somebody wants it to end."""


class Run:
    """Measured on one thread, and looked at and talked to from another.

    Args:
        total: exposures that it takes.
        tell: takes every change worth telling; called on both threads.
        patience: longest wait for a scene [s].
    """

    def __init__(
        self,
        total: int,
        tell: Callable[[CalibrationRun], None],
        *,
        patience: float = PATIENCE,
    ) -> None:
        self._tell, self._patience = tell, patience
        self._every = max(1, total // _TOLD)
        self._lock = threading.Lock()
        self._cancelled = threading.Event()
        self._presented: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._seen = CalibrationRun(
            stage="measuring", scene=None, instruction=None, exposures=0, total=total, detail=None
        )

    @property
    def seen(self) -> CalibrationRun:
        """How far it is."""
        return self._seen

    def presented(self, scene: SceneName) -> None:
        """The scene that is waited for is there; raises :class:`SceneNotWantedError`."""
        with self._lock:
            seen = self._seen
            if seen.stage != "waiting" or seen.scene != scene:
                raise SceneNotWantedError(scene, seen.scene if seen.stage == "waiting" else None)
            self._change(stage="measuring", scene=scene)
        self._presented.put(None)

    def cancel(self) -> None:
        """Let the next exposure, fit or wait end it."""
        self._cancelled.set()
        self._presented.put(None)

    def end(self, stage: Stage, detail: str | None = None) -> None:
        """It is over."""
        with self._lock:
            self._change(stage=stage, scene=None, detail=detail)

    def ask_for(self, scene: CalibrationScene) -> None:
        """Wait until somebody has held up a scene.

        Raises:
            CancelledError: nobody will.
            CalibrationError: nobody did in time.
        """
        with self._lock:
            self._change(stage="waiting", scene=scene.name, instruction=scene.instruction)
        try:
            self._presented.get(timeout=self._patience)
        except queue.Empty:
            raise CalibrationError(
                f"nobody said within {self._patience:g} s that the {scene.name} scene is there: "
                "start again"
            ) from None
        self.check()

    def hold_up(self, scenes: Scenes, scene: CalibrationScene) -> None:
        """Hold a scene up before a simulated camera."""
        scenes.hold(scene.image)
        with self._lock:
            self._change(stage="measuring", scene=scene.name)

    def fit(self) -> None:
        """Everything is read: from here on it computes."""
        with self._lock:
            self._change(stage="fitting", scene=None)

    def advance(self) -> None:
        """One more exposure was taken."""
        with self._lock:
            exposures = self._seen.exposures + 1
            self._seen = self._seen.model_copy(update={"exposures": exposures})
            if exposures % self._every == 0:
                self._tell(self._seen)

    def check(self) -> None:
        """Raise :class:`CancelledError` if it is to end."""
        if self._cancelled.is_set():
            raise CancelledError

    def _change(
        self,
        *,
        stage: Stage,
        scene: SceneName | None,
        instruction: str | None = None,
        detail: str | None = None,
    ) -> None:
        self._seen = self._seen.model_copy(
            update={"stage": stage, "scene": scene, "instruction": instruction, "detail": detail}
        )
        self._tell(self._seen)
