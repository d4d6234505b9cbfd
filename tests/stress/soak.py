"""The daemon's engine on emulated hardware that fails at random: no reading mixed, reused or lost.

    python tests/stress/soak.py --figures benchmarks/results/daemon.json

Every capture has a mask of its own. The light carries 64 of the mask's levels to the 64 values of a
reading, so each reading tells which mask, or which mixture, it was taken under. Meanwhile the
panel's bus breaks off in the middle of masks, the camera hangs, gives old frames and gives frames
twice, and the disk is full. Every now and then the engine is stopped and started with a wall clock
that jumped by up to a year. Then it is killed (SIGKILL) at random moments, again and again, on one
state directory. What only the optical self test can see, a panel that takes bytes and does not show
them, is left out: its own tests are for that.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import hashlib
import math
import multiprocessing
import random
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import torch
import typer
from rich.progress import track

from veilcam_client.wire.captures import Form, Prediction
from veilcam_client.wire.rotation import EveryCaptures
from veilcam_optics.camera.geometry import Camera, Embedding
from veilcam_optics.simulation.operator import Response
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.camera.capture import Fence
from veilcam_server.camera.epochs import EpochStore, Preparation
from veilcam_server.devices import Device, DeviceError
from veilcam_server.devices.base import Levels, Reading, Shown
from veilcam_server.devices.imx477 import IMX477, ExposureRange
from veilcam_server.devices.raw import SensorMode
from veilcam_server.devices.simulated.device import Conditions, SimulatedLight
from veilcam_server.devices.simulated.panel import Crystal, PanelEmulator
from veilcam_server.devices.simulated.picamera import CameraFaults, FakePicamera2
from veilcam_server.devices.simulated.scenes import Scenes
from veilcam_server.devices.st7735r import ST7735R
from veilcam_server.devices.st7735r_glass import TABS
from veilcam_server.errors import EpochError, FenceError, NotReadyError
from veilcam_server.masks.source import Mask
from veilcam_training.experiments.records import record_figures

CAMERA, EMBEDDING = Camera(), Embedding(8, 8)
MODE = SensorMode(16, 16, line_time=0.0, frame_duration=0.0)
CRYSTAL = Crystal(scan=5e-4, settle=5e-4)
SETTLE, TIMEOUT = 1e-3, 0.05
"""What the engine grants the crystal, and how long it waits for a frame [s]."""
YEAR = 365 * 86_400.0
WARM_UP = 0.2
"""Share of the captures after which memory must have stopped growing."""
KNOWN = (DeviceError, EpochError, FenceError, NotReadyError)


def draw(key: int, counter: int) -> Levels:
    """The mask of an epoch."""
    levels: Levels = np.random.default_rng((key, counter)).integers(
        0, CAMERA.panel.levels, CAMERA.mask_shape, np.uint8
    )
    return levels


@dataclass(frozen=True)
class Numbered:
    """A reader that knows the epoch of its mask, and reads nothing."""

    counter: int

    def classify(self, embedding: Reading) -> Prediction:
        """Labels play no part here."""
        raise NotImplementedError

    def release(self, embedding: Reading, form: Form) -> Reading:
        """Return it as it is."""
        del form
        return embedding


@dataclass(frozen=True)
class Drawn:
    """A source of masks, a new one for every epoch."""

    key: int
    renewable: bool = True

    def name(self, counter: int) -> str:
        """Return a name that looks random."""
        return hashlib.sha256(f"{self.key} {counter}".encode()).hexdigest()[:32]

    def make(self, counter: int, last_mark: str) -> Mask:
        """Return the mask of an epoch."""
        del last_mark
        return Mask(draw(self.key, counter), Numbered(counter))


class White:
    """A white scene."""

    def read(self) -> npt.NDArray[np.float32]:
        """Return it."""
        return np.ones((2, 2), np.float32)


class Marked:
    """Light that carries the levels of the mask's first corner, one to each box of the reading."""

    def response(self, weights: torch.Tensor) -> Response:
        """Return the corner."""
        return (weights[: EMBEDDING.rows, : EMBEDDING.columns].double(),)

    def collect(self, scenes: torch.Tensor, response: Response) -> torch.Tensor:
        """Return it on raw pixels."""
        factor = MODE.rows // EMBEDDING.rows
        boxes = response[0].repeat_interleave(factor, 0).repeat_interleave(factor, 1)
        return boxes.expand(len(scenes), -1, -1)


class Passed:
    """A self test that was passed: this light has no geometry to test by."""

    def run(self, device: Device, fence: Fence) -> None:
        """Nothing is shown."""


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

    def close(self) -> None:
        """Nothing is held open."""


class FullDisk(EpochStore):
    """A store whose disk is full, so many times."""

    fulls = 0

    def next(self) -> int:
        """Commit the next epoch, or fail."""
        if self.fulls > 0:
            self.fulls -= 1
            raise EpochError("the mask epoch cannot be recorded (database or disk is full)")
        return super().next()


class Rig:
    """An engine on hardware that fails when told."""

    def __init__(
        self,
        key: int,
        directory: Path,
        *,
        now: Callable[[], float] = time.time,
        granted: float = SETTLE,
        tell: Callable[[Levels], None] = lambda _: None,
    ) -> None:
        self.key = key
        panel = PanelEmulator(TABS["green"], crystal=CRYSTAL, reset_time=0.0)
        self.bus, self.frames = BrokenBus(panel), CameraFaults()
        display = ST7735R(self.bus, panel, camera=CAMERA, tab=TABS["green"], sleep=lambda _: None)
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
            Marked(),
            camera=CAMERA,
            embedding=EMBEDDING,
            conditions=Conditions(exposure=0.0, snr_db=math.inf),
            mode=MODE,
            full_scale=1.1,
            seed=0,
            began_at=0.0,
        )
        sensor = IMX477(
            lambda: FakePicamera2(light, mode=MODE, faults=self.frames),
            shape=EMBEDDING.shape,
            mode=MODE,
            exposures=ExposureRange(0.0),
            full_scale=1.1,
            # Random faults come in a row, too; restarts are what the other half of this is for.
            failures=1000,
        )
        self.disk = FullDisk(directory, now)
        self.camera = MaskedCamera(
            Device(display, sensor, simulated=True),
            Preparation(Drawn(key), self.disk),
            EMBEDDING.shape,
            Passed(),
            fence=Fence(granted, TIMEOUT),
            policy=EveryCaptures(captures=1),
        )

    def break_something(self, share: float) -> None:
        """At random, make the next thing of its kind fail."""
        if random.random() < share:
            kind = random.randrange(6)
            if kind == 0:
                self.bus.breaks = random.choice((1, 1, 2, 3))
            elif kind == 1:
                self.frames.hangs = 1
            elif kind == 2:
                self.frames.stale = 2
            elif kind == 3:
                self.frames.stuck = True
            elif kind == 4:
                self.disk.fulls = 1
            else:
                self.frames.gain = 2.0

    def mend(self) -> None:
        """End what would last."""
        self.frames.stuck, self.frames.gain = False, 1.0


@dataclass
class Outcome:
    """What a run came to."""

    captures: int = 0
    mixed: int = 0
    errors: int = 0
    lost: int = 0
    """Captures that ended neither in a reading nor in an error that the daemon knows."""
    counters: list[int] = field(default_factory=list)
    """Of the epochs that readings were taken under."""
    masks: list[bytes] = field(default_factory=list)
    """Digests of all masks that were put on the panel, but for those that were put back."""
    growth: float = 0.0
    """Of resident memory after the warm-up [MB]."""

    @property
    def reused(self) -> int:
        """Readings under an epoch, or showings of a mask, that was there before."""
        return sum(len(items) - len(set(items)) for items in (self.counters, self.masks))


def attempt(rig: Rig, outcome: Outcome) -> None:
    """Take one capture and judge it."""
    try:
        captured = rig.camera.capture()
    except KNOWN:
        outcome.errors += 1
        rig.mend()
        if rig.camera.state[0] == "safe":
            try:
                rig.camera.rotate()
            except KNOWN:
                outcome.errors += 1
        return
    except Exception:
        outcome.lost += 1
        return
    reader = captured.reader
    assert isinstance(reader, Numbered)
    outcome.captures += 1
    outcome.counters.append(reader.counter)
    planted = draw(rig.key, reader.counter)[: EMBEDDING.rows, : EMBEDDING.columns]
    seen = captured.embedding * (CAMERA.panel.levels - 1)
    outcome.mixed += bool(np.abs(seen - planted).max() > 0.1)


def soak(
    directory: Path,
    captures: int,
    *,
    faults: float = 0.05,
    granted: float = SETTLE,
    restart_every: int = 2000,
    advance: Callable[[], None] = lambda: None,
) -> Outcome:
    """Take captures on hardware that fails, over engines whose wall clock jumps."""
    outcome, key = Outcome(), random.getrandbits(64)

    def tell(levels: Levels) -> None:
        outcome.masks.append(hashlib.sha256(levels.tobytes()).digest())

    warm, done = 0.0, 0
    while done < captures:
        now = partial(_jumped, random.uniform(-YEAR, YEAR))
        rig = Rig(key, directory, now=now, granted=granted, tell=tell)
        try:
            rig.camera.rotate()
            for _ in range(min(restart_every, captures - done)):
                if done == int(WARM_UP * captures):
                    warm = resident()
                rig.break_something(faults)
                attempt(rig, outcome)
                done += 1
                advance()
        finally:
            rig.mend()
            rig.bus.breaks = rig.frames.hangs = rig.disk.fulls = 0
            rig.camera.stop()
    outcome.growth = resident() - warm
    return outcome


def _jumped(jump: float) -> float:
    """The wall clock, elsewhere [s]."""
    return time.time() + jump


def kill(directory: Path, lives: int, advance: Callable[[], None] = lambda: None) -> list[str]:
    """Kill the engine at random moments; return a digest of every mask that it ever showed."""
    log, key = directory / "shown", random.getrandbits(64)
    log.touch(mode=0o600)
    fork = multiprocessing.get_context("fork")
    for life in range(lives):
        child = fork.Process(target=_live, args=(key, directory, log))
        child.start()
        lines = log.read_text().count("\n")
        # Every fourth dies while it starts; the others once they have shown something.
        while life % 4 and child.is_alive() and log.read_text().count("\n") == lines:
            time.sleep(0.005)
        time.sleep(random.uniform(0.0, 0.2))
        child.kill()
        child.join()
        if child.exitcode != -9:
            raise RuntimeError(f"the engine ended by itself with {child.exitcode}")
        advance()
    return log.read_text().splitlines()


def _live(key: int, directory: Path, log: Path) -> None:
    """Capture until killed. What the panel shows is in the log before it is shown."""
    descriptor = os.open(log, os.O_WRONLY | os.O_APPEND)

    def tell(levels: Levels) -> None:
        os.write(descriptor, hashlib.sha256(levels.tobytes()).hexdigest().encode() + b"\n")

    # A wall clock that stands still: what was committed to the disk must be enough.
    rig = Rig(key, directory, now=lambda: 0.0, tell=tell)
    rig.camera.rotate()
    while True:
        rig.camera.capture()


def resident() -> float:
    """Resident memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main(
    *,
    captures: Annotated[int, typer.Option(min=10, help="To try.")] = 20_000,
    kills: Annotated[int, typer.Option(min=0, help="How often to kill the engine.")] = 20,
    faults: Annotated[
        float, typer.Option(min=0, max=1, help="Share of captures that meet a fault.")
    ] = 0.05,
    figures: Annotated[Path | None, typer.Option(help="Record to write figures into.")] = None,
) -> None:
    """Look for readings that are mixed, under a used epoch or lost, and for memory that grows."""
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory(prefix="veilcam-") as temporary:
        # Before anything starts a thread: a fork copies no threads, but the locks they hold.
        killed = Path(temporary) / "killed"
        killed.mkdir()
        shown = kill(killed, kills)
        steps = iter(track(range(captures), "captures"))

        def advance() -> None:
            next(steps, None)

        outcome = soak(Path(temporary) / "soaked", captures, faults=faults, advance=advance)
    again = len(shown) - len(set(shown))
    print(f"kills: {kills}, {len(shown)} masks shown, {again} of them again")
    print(
        f"captures: {captures} tried, {outcome.captures} taken, {outcome.errors} errors, "
        f"{outcome.mixed} mixed, {outcome.reused} reused, {outcome.lost} lost, "
        f"memory {outcome.growth:+.1f} MB"
    )
    if figures is not None:
        record_figures(
            figures,
            {
                "soak_captures": captures,
                "soak_mixed": outcome.mixed,
                "soak_reused": outcome.reused + again,
                "soak_lost": outcome.lost,
                "soak_growth_mb": outcome.growth,
            },
        )
    if outcome.mixed + outcome.reused + again + outcome.lost or outcome.growth > 20:
        raise SystemExit(1)


if __name__ == "__main__":
    typer.run(main)
