"""Row of the soak: the daemon's engine on emulated hardware that fails at random.

Every capture has a mask of its own, drawn from a key. The light carries 64 of the mask's levels to
the 64 values of a measurement, so each measurement tells its mask, or its mixture of masks. Every
embedding leaves: sealed, and opened again by a receiver, or raw. Meanwhile somebody changes masks
by hand. The panel's bus breaks off in the middle of masks; the camera hangs, gives old frames and
gives frames twice. Engines are stopped and started; the row ``kill`` kills whole daemons. A panel
that takes bytes and does not show them is left to the self test's tests.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import random
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from benchmarks.rig import resident
from tests.siege.ground import Ground, Judgement
from tests.siege.samples import fresh_bundle

from veilcam_client.errors import SealedError
from veilcam_client.keys.blocks import Opener
from veilcam_client.keys.receivers import Receiver, ReceiverKey
from veilcam_client.wire.captures import Capture
from veilcam_client.wire.rotation import EveryCaptures
from veilcam_client.wire.sealing import Release
from veilcam_optics.camera.geometry import Camera, Embedding
from veilcam_optics.simulation.operator import Response
from veilcam_server.camera.budget import ReleaseBudget
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.camera.capture import Captured, Fence, MaskedCapture
from veilcam_server.camera.epochs import Preparation
from veilcam_server.devices import Device, DeviceError
from veilcam_server.devices.base import Levels, Shown
from veilcam_server.devices.imx477 import IMX477, ExposureRange
from veilcam_server.devices.raw import SensorMode
from veilcam_server.devices.reopening import ReopeningDisplay, ReopeningSensor
from veilcam_server.devices.simulated.device import Conditions, SimulatedLight
from veilcam_server.devices.simulated.panel import Crystal, PanelEmulator
from veilcam_server.devices.simulated.picamera import CameraFaults, FakePicamera2
from veilcam_server.devices.simulated.scenes import Scenes
from veilcam_server.devices.st7735r import ST7735R
from veilcam_server.devices.st7735r_glass import TABS
from veilcam_server.errors import FenceError, NotReadyError
from veilcam_server.masks.fresh import FreshSource
from veilcam_server.masks.source import Terms
from veilcam_server.sealing.identity import DeviceKey

CAMERA, EMBEDDING = Camera(), Embedding(8, 8)
DIGEST = "0f" * 32
MODE = SensorMode(48, 64, line_time=0.0, frame_duration=0.0)
CRYSTAL = Crystal(scan=5e-4, settle=5e-4)
SETTLE, TIMEOUT = 1e-3, 0.05
"""Time that the engine grants the crystal, and its longest wait for a frame [s]."""
FORMS: tuple[Release, ...] = ("sealed", "raw")
WARM_UP = 0.2
"""Share of the captures after which memory must have stopped growing."""
GROWTH = 20.0  # [MB]
FAULTS = 0.1
KNOWN = (DeviceError, FenceError, NotReadyError)


@cache
def fresh_masks() -> FreshSource:
    return FreshSource(replace(fresh_bundle(CAMERA, EMBEDDING, 32), digest=DIGEST))


class CornerLight:
    def read(self) -> npt.NDArray[np.float32]:
        return np.ones((2, 2), np.float32)

    def response(self, weights: torch.Tensor) -> Response:
        return (weights[: EMBEDDING.rows, : EMBEDDING.columns].double(),)

    def collect(self, scenes: torch.Tensor, response: Response) -> torch.Tensor:
        down, across = MODE.rows // EMBEDDING.rows, MODE.columns // EMBEDDING.columns
        boxes = response[0].repeat_interleave(down, 0).repeat_interleave(across, 1)
        return boxes.expand(len(scenes), -1, -1)

    def run(self, device: Device, fence: Fence) -> float:
        """Pass the self test: this light has no geometry to test by, and nothing leaks."""
        return 0.0


class Bus(PanelEmulator):
    """Panel whose bus breaks off in the middle of a mask, ``breaks`` times."""

    breaks = 0

    def write(self, buffer: memoryview | bytes) -> None:
        broken = self.breaks > 0 and len(buffer) > 1000
        super().write(bytes(buffer[: len(buffer) // 2]) if broken else buffer)
        if broken:
            self.breaks -= 1
            raise OSError(5, "Input/output error")


class Rig:
    """Engine on hardware that fails when told; ``tell`` gets every mask before it is shown."""

    def __init__(
        self, directory: Path, receiver: Receiver, *, tell: Callable[[Levels], None], form: Release
    ) -> None:
        self.bus, self.frames = Bus(TABS["green"], crystal=CRYSTAL, reset_time=0.0), CameraFaults()
        # Random faults come in a row, too, and nobody waits here for another attempt.
        unhurried = itertools.count(0.0, 100.0).__next__
        bus = (self.bus, self.bus)
        panel = partial(ST7735R, *bus, camera=CAMERA, tab=TABS["green"], sleep=lambda _: None)
        display = ReopeningDisplay("ST7735R", panel, clock=unhurried)
        show, standing = display.show, b""

        def told(levels: Levels) -> Shown:
            nonlocal standing
            if not levels.any():
                return show(levels)  # opaque: it shows no mask, and ends no showing
            # After a failed write the mask from before is put back: the same showing goes on.
            if levels.tobytes() != standing:
                tell(levels)
            shown = show(levels)
            standing = levels.tobytes()
            return shown

        display.show = told  # type: ignore[method-assign]
        light, shape = CornerLight(), EMBEDDING.shape
        optics: dict[str, Any] = {"camera": CAMERA, "embedding": EMBEDDING, "seed": 0}
        optics |= {"conditions": Conditions(exposure=0.0, snr_db=math.inf)}
        sensed: dict[str, Any] = {"mode": MODE, "full_scale": 1.1}
        seen = SimulatedLight(self.bus, Scenes((light,)), light, **optics, **sensed)
        frames = partial(FakePicamera2, seen, mode=MODE, faults=self.frames)
        camera = partial(IMX477, frames, shape=shape, exposures=ExposureRange(0.0), **sensed)
        sensor = ReopeningSensor("IMX477", 1.1, camera, clock=unhurried)
        signer, budget = DeviceKey.open(directory), ReleaseBudget(directory, raw=1)
        terms = Terms(form, (receiver,) if form == "sealed" else ())
        self.camera = MaskedCamera(
            Device(display, sensor, simulated=True),
            # This light is of no camera that real tests could know.
            Preparation(fresh_masks(), signer, lambda: terms, budget),
            shape,
            light,
            fence=Fence(SETTLE, TIMEOUT),
            policy=EveryCaptures(captures=1),
        )

    def break_something(self) -> None:
        breaks = random.choice((1, 1, 2, 3))
        faults = (
            *((self.bus, "breaks", breaks), (self.frames, "hangs", 1), (self.frames, "stale", 2)),
            *((self.frames, "stuck", True), (self.frames, "gain", 2.0)),
        )
        setattr(*random.choice(faults))

    def mend(self) -> None:
        self.frames.stuck, self.frames.gain = False, 1.0

    def stop(self) -> None:
        self.mend()
        self.bus.breaks = self.frames.hangs = 0
        self.camera.stop()

    def meddle(self, ended: threading.Event) -> None:
        while not ended.wait(random.expovariate(5.0)):
            with suppress(*KNOWN):
                self.camera.rotate()


@dataclass
class Outcome:
    """Counts of a run.

    Mixed are measurements of another mask than their own. Lost are captures that ended neither in
    a measurement, which its receiver could open, nor in an error that the daemon knows.
    """

    captures: int = 0
    mixed: int = 0
    errors: int = 0
    lost: int = 0
    epochs: list[str] = field(default_factory=list)
    masks: list[bytes] = field(default_factory=list)
    growth: float = 0.0

    @property
    def reused(self) -> int:
        """Number of measurements under a used epoch, and of showings of a used mask."""
        return sum(len(items) - len(set(items)) for items in (self.epochs, self.masks))

    def attempt(self, rig: Rig, opener: Opener) -> None:
        try:
            captured = rig.camera.capture(release=True)
        except KNOWN:
            self.errors += 1
            rig.mend()
            if rig.camera.state.state in ("safe", "degraded"):
                try:
                    rig.camera.rotate()
                except KNOWN:
                    self.errors += 1
            return
        except Exception:
            self.lost += 1
            return
        try:
            self._judge(captured, opener)
        except SealedError:
            self.lost += 1
        finally:
            captured.done()

    def _judge(self, captured: Captured, opener: Opener) -> None:
        assert isinstance(captured, MaskedCapture)
        self.captures += 1
        self.epochs.append(captured.epoch)
        captured.classify()
        measured, embedding = captured.measurement, captured.release(0.0)
        if captured.form == "sealed":
            told = {each: getattr(captured, each) for each in ("epoch", "number", "taken_at")}
            answer = Capture(id="", **told, embedding=embedding)
            measured = np.asarray(opener.open(answer).embedding)
        seen = measured * (CAMERA.panel.levels - 1)
        corner = captured.active.mask.levels[: EMBEDDING.rows, : EMBEDDING.columns].astype(float)
        self.mixed += bool(np.abs(seen - corner).max() > 0.1)


def soak(directory: Path, captures: int, *, faults: float = FAULTS, every: int = 2000) -> Outcome:
    receiver, outcome, forms = ReceiverKey.generate(), Outcome(), itertools.cycle(FORMS)
    opener = Opener(receiver)

    def tell(levels: Levels) -> None:
        outcome.masks.append(hashlib.sha256(levels.tobytes()).digest())

    warm, done = 0.0, 0
    while done < captures:
        rig = Rig(directory, receiver.public, form=next(forms), tell=tell)
        ended = threading.Event()
        meddler = threading.Thread(target=rig.meddle, args=(ended,))
        meddler.start()
        try:
            rig.camera.rotate()
            for _ in range(min(every, captures - done)):
                if done == int(WARM_UP * captures):
                    warm = resident()
                if random.random() < faults:
                    rig.break_something()
                outcome.attempt(rig, opener)
                done += 1
        finally:
            ended.set()
            meddler.join()
            rig.stop()
    outcome.growth = resident() - warm
    return outcome


async def soaked(ground: Ground, judgement: Judgement) -> None:
    torch.set_num_threads(1)
    captures = ground.extent.captures
    outcome = soak(ground.folder / "soak", captures, every=max(20, captures // 10))
    for what, count, figure in (
        ("mixed", outcome.mixed, "soak_mixed"),
        ("used again", outcome.reused, "soak_reused"),
        ("lost", outcome.lost, "soak_lost"),
    ):
        judgement.at_most(f"{what} of {outcome.captures} captures", count, 0, figure=figure)
    judgement.at_least(f"captures beside {outcome.errors} errors", outcome.captures, 1)
    judgement.at_most("memory [MB]", outcome.growth, GROWTH, figure="soak_growth_mb")
    judgement.figures["soak_captures"] = captures
