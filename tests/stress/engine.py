"""The daemon's engine on emulated hardware that fails when told, with masks drawn from keys."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.captures import Prediction
from veilcam_client.wire.rotation import EveryCaptures
from veilcam_client.wire.sealing import Release
from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.decoding import MeasurementNoise, fit_statistics
from veilcam_optics.keys.masks import MaskDistribution
from veilcam_optics.simulation.operator import Response
from veilcam_server.camera.budget import ReleaseBudget
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.camera.capture import Fence
from veilcam_server.camera.epochs import Preparation
from veilcam_server.demo_data import load_digits
from veilcam_server.devices import Device
from veilcam_server.devices.base import Levels, Measurement, Shown
from veilcam_server.devices.imx477 import IMX477, ExposureRange
from veilcam_server.devices.raw import SensorMode
from veilcam_server.devices.reopening import ReopeningDisplay, ReopeningSensor
from veilcam_server.devices.simulated.device import Conditions, SimulatedLight
from veilcam_server.devices.simulated.panel import Crystal, PanelEmulator
from veilcam_server.devices.simulated.picamera import CameraFaults, FakePicamera2
from veilcam_server.devices.simulated.scenes import Scenes
from veilcam_server.devices.st7735r import ST7735R
from veilcam_server.devices.st7735r_glass import TABS
from veilcam_server.masks.fresh import FreshSource
from veilcam_server.masks.source import Evidence, Mask, Reader, Terms
from veilcam_server.sealing.identity import DeviceKey
from veilcam_training.bundle import Bundle, Fresh
from veilcam_training.bundle.layers import AveragePool, Flatten, Linear, Reshape
from veilcam_training.models.network import build_untrained, weights_of

CAMERA, SCENE, EMBEDDING = Camera(), Scene(), Embedding(8, 8)
DIGEST = "0f" * 32
"""Of a bundle that comes from no file."""
MODE = SensorMode(48, 64, line_time=0.0, frame_duration=0.0)
CRYSTAL = Crystal(scan=5e-4, settle=5e-4)
SETTLE, TIMEOUT = 1e-3, 0.05
"""What the engine grants the crystal, and how long it waits for a frame [s]."""


def make_bundle() -> Bundle:
    """A camera of the real size with an untrained classifier: labels play no part here."""
    layers = (
        Reshape(shape=(2, *SCENE.shape)),
        AveragePool(rows=4, columns=4),
        Flatten(),
        Linear(inputs=32, outputs=10),
    )
    digits = load_digits().images[:200] / np.float32(255)
    return Bundle(
        task="mnist",
        labels=tuple("0123456789"),
        camera=CAMERA,
        scene=SCENE,
        embedding=EMBEDDING,
        mode="fresh",
        digest=DIGEST,
        fresh=Fresh(
            distribution=MaskDistribution.uniform(CAMERA),
            statistics=fit_statistics([digits], 32),
            noise=MeasurementNoise(),
            layers=layers,
            weights=weights_of(build_untrained(layers)),
        ),
    )


@dataclass(frozen=True, eq=False)
class Marked:
    """A reader that knows the first corner of its mask, also after the mask was erased."""

    corner: Measurement
    reader: Reader

    def classify(self, measurement: Measurement) -> Prediction:
        """Classify as the reader does."""
        return self.reader.classify(measurement)

    def evidence(self, measurement: Measurement) -> Evidence:
        """Tell what the reader does."""
        return self.reader.evidence(measurement)

    def whiten(self, measurement: Measurement) -> Measurement:
        """Whiten as the reader does."""
        return self.reader.whiten(measurement)

    def erase(self) -> None:
        """Erase what the reader has."""
        self.reader.erase()


class MarkedSource(FreshSource):
    """The daemon's own source of masks, whose readers can be told apart."""

    def make(self, key: EpochKey, form: Release, avoid: frozenset[str]) -> Mask:
        """Prepare an epoch."""
        mask = super().make(key, form, avoid)
        corner = mask.levels[: EMBEDDING.rows, : EMBEDDING.columns].astype(np.float32)
        return Mask(mask.levels, Marked(corner, mask.reader))


class Supply:
    """Where masks come from, and who receives, however often an engine is started."""

    def __init__(self) -> None:
        # Built once: it is what takes time when an engine starts.
        self.source = MarkedSource(make_bundle())
        self.receiver = ReceiverKey.generate()

    def terms(self, form: Release) -> Terms:
        """What holds for every epoch of one engine."""
        return Terms(form, (self.receiver.public,) if form == "sealed" else ())


class White:
    """A white scene."""

    def read(self) -> npt.NDArray[np.float32]:
        """Return it."""
        return np.ones((2, 2), np.float32)


class CornerLight:
    """Light that carries the levels of the mask's first corner, one to each box measured."""

    def response(self, weights: torch.Tensor) -> Response:
        """Return the corner."""
        return (weights[: EMBEDDING.rows, : EMBEDDING.columns].double(),)

    def collect(self, scenes: torch.Tensor, response: Response) -> torch.Tensor:
        """Return it on raw pixels."""
        down, across = MODE.rows // EMBEDDING.rows, MODE.columns // EMBEDDING.columns
        boxes = response[0].repeat_interleave(down, 0).repeat_interleave(across, 1)
        return boxes.expand(len(scenes), -1, -1)


class Passed:
    """A self test that was passed: this light has no geometry to test by."""

    def run(self, device: Device, fence: Fence) -> float:
        """Nothing is shown."""
        return 0.0


@dataclass
class BrokenBus:
    """A bus that breaks off in the middle of a mask, so many times."""

    panel: PanelEmulator
    breaks: int = 0

    def write(self, buffer: memoryview | bytes) -> None:
        """Send all, or half of it."""
        if self.breaks > 0 and len(buffer) > 1000:
            self.breaks -= 1
            self.panel.write(bytes(buffer[: len(buffer) // 2]))
            raise OSError(5, "Input/output error")
        self.panel.write(buffer)

    def read(self, command: int, count: int) -> bytes:
        """Ask the panel."""
        return self.panel.read(command, count)

    def close(self) -> None:
        """Nothing is held open."""


class Rig:
    """An engine on hardware that fails when told."""

    def __init__(
        self,
        supply: Supply,
        directory: Path,
        *,
        form: Release = "sealed",
        granted: float = SETTLE,
        tell: Callable[[Levels], None] = lambda _: None,
    ) -> None:
        panel = PanelEmulator(TABS["green"], crystal=CRYSTAL, reset_time=0.0)
        # Random faults come in a row, too, and nobody waits here for another attempt.
        unhurried = itertools.count(0.0, 100.0).__next__
        self.bus, self.frames = BrokenBus(panel), CameraFaults()
        display = ReopeningDisplay(
            "ST7735R",
            partial(
                ST7735R,
                *(self.bus, panel),
                camera=CAMERA,
                tab=TABS["green"],
                sleep=lambda _: None,
            ),
            clock=unhurried,
        )
        show = display.show

        standing = b""

        def told(levels: Levels) -> Shown:
            nonlocal standing
            # After a failed write the mask from before is put back: the same showing goes on.
            if levels.tobytes() != standing:
                tell(levels)
            shown = show(levels)
            standing = levels.tobytes()
            return shown

        display.show = told  # type: ignore[method-assign]
        light = SimulatedLight(
            panel,
            Scenes((White(),)),
            CornerLight(),
            camera=CAMERA,
            embedding=EMBEDDING,
            conditions=Conditions(exposure=0.0, snr_db=math.inf),
            mode=MODE,
            full_scale=1.1,
            seed=0,
        )
        sensor = ReopeningSensor(
            "IMX477",
            1.1,
            lambda: IMX477(
                lambda: FakePicamera2(light, mode=MODE, faults=self.frames),
                shape=EMBEDDING.shape,
                mode=MODE,
                exposures=ExposureRange(0.0),
                full_scale=1.1,
            ),
            clock=unhurried,
        )
        budget, terms = ReleaseBudget(directory, raw=0), supply.terms(form)
        signer = DeviceKey.open(directory)
        self.camera = MaskedCamera(
            Device(display, sensor, simulated=True),
            # This light is of no camera that real tests could know.
            Preparation(supply.source, signer, lambda: terms, budget),
            EMBEDDING.shape,
            Passed(),
            budget=budget,
            fence=Fence(granted, TIMEOUT),
            policy=EveryCaptures(captures=1),
        )

    def break_something(self, share: float) -> None:
        """At random, make the next thing of its kind fail."""
        if random.random() < share:
            kind = random.randrange(5)
            if kind == 0:
                self.bus.breaks = random.choice((1, 1, 2, 3))
            elif kind == 1:
                self.frames.hangs = 1
            elif kind == 2:
                self.frames.stale = 2
            elif kind == 3:
                self.frames.stuck = True
            else:
                self.frames.gain = 2.0

    def mend(self) -> None:
        """End what would last."""
        self.frames.stuck, self.frames.gain = False, 1.0
