"""A small simulated camera that somebody built badly, and the scenes that it is shown."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from tests.unit.server.devices.clock import Clock

from veilcam_optics.camera import imperfections as optical
from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Window
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.simulation.operator import LightOperator
from veilcam_server.calibration.measurements import Budget
from veilcam_server.calibration.procedure import Calibrated, calibrate
from veilcam_server.calibration.rig import CalibrationScene, Geometry, Patterns
from veilcam_server.devices.base import Device
from veilcam_server.devices.simulated.device import Conditions, simulated_device
from veilcam_server.devices.simulated.light import raw_shape

GEOMETRY = Geometry(
    Camera(window=Window(rows=15, columns=7)), Scene(rows=6, columns=6), Embedding(24, 16)
)
BUDGET = Budget(repeats=1, samples=3, patterns=Patterns(coarse=3, fine=4, held_out=2))
SETTLE, SCAN, EXPOSURE = 0.04, 0.01, 0.01
QUIET = Conditions(SETTLE, EXPOSURE, scan=SCAN)


class Built:
    """A camera on a clock of its own.

    Args:
        imperfections: how it departs from a nominal one.
        hardware: of panel and sensor.
    """

    def __init__(
        self, imperfections: optical.Imperfections = optical.NOMINAL, hardware: Conditions = QUIET
    ) -> None:
        self.clock = Clock()
        self.image: npt.NDArray[np.float32] = np.ones(GEOMETRY.scene.shape, np.float32)
        self.presented: list[str] = []
        self.captures = 0
        light = LightOperator(
            Model(
                GEOMETRY.camera,
                GEOMETRY.scene,
                Embedding(*raw_shape(GEOMETRY.embedding)),
                optical.Conditions(imperfections=imperfections),
                Sampling("transfer", step=6.2e-6),
            )
        )
        self.device: Device = simulated_device(
            light,
            self,
            camera=GEOMETRY.camera,
            embedding=GEOMETRY.embedding,
            conditions=hardware,
            seed=3,
            clock=self.clock,
            sleep=self.clock.sleep,
        )

    def read(self) -> npt.NDArray[np.float32]:
        """What is in front of it."""
        return self.image

    def present(self, scene: CalibrationScene) -> None:
        """Hold up what is asked for."""
        self.presented.append(scene.name)
        self.image = scene.image

    def calibrate(self, *, longest: float = 0.12, budget: Budget = BUDGET) -> Calibrated:
        """Measure it with itself."""

        def advance() -> None:
            self.captures += 1

        return calibrate(
            self.device,
            GEOMETRY,
            self.present,
            longest=longest,
            exposure=EXPOSURE,
            budget=budget,
            advance=advance,
            clock=self.clock,
        )
