"""The guard in a daemon: faults over REST, lost transfers, rates and latencies."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from threading import Timer
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.guard.world import FAULTS, Array, scenes
from veilcam_client import Camera
from veilcam_client.errors import ApiError, VeilcamError
from veilcam_client.models import Faults, LightFaults, PanelFaults
from veilcam_client.wire.rotation import EveryCaptures
from veilcam_optics.camera.geometry import Camera as GeometricCamera
from veilcam_server import daemon
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.camera.capture import Fence
from veilcam_server.camera.guard import Guard
from veilcam_server.demo.daemon import running
from veilcam_server.demo_data import BUNDLE
from veilcam_server.devices import Device
from veilcam_server.devices.base import Levels, Light
from veilcam_server.devices.simulated.panel import Crystal, PanelEmulator
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.devices.st7735r import ST7735R
from veilcam_server.devices.st7735r_glass import TABS
from veilcam_server.errors import PanelNotHidingError, UnsteadyLightError
from veilcam_server.service import served_camera
from veilcam_server.settings import Settings

KINDS = ("digit", "digit on gray", "dark digit on white", "wall", "gradient", "1/f", "noise")
"""Scenes with light enough for a verdict; a point has too little."""


@contextmanager
def _daemon(folder: Path, bundle: Path, *options: str) -> Iterator[str]:
    folder.mkdir()
    write_scene(folder / "scene.npy", np.full((28, 28), 255, np.uint8))
    with running(bundle, folder / "scene.npy", folder, "--scene-api", *options) as url:
        yield url


def _ready(camera: Camera) -> None:
    """Mend the camera, and wait for a sound capture."""
    camera.simulation.set_faults(Faults())
    for _ in range(100):
        with suppress(VeilcamError):
            if camera.status().state != "ready":
                camera.rotation.advance()
            camera.classify()
            return
        time.sleep(0.1)
    raise RuntimeError("the camera does not come back")


def rest_faults(folder: Path, bundle: Path, fault: str, tries: int, until: float) -> Counter[str]:
    """Count what a daemon says of the first and second capture after a fault, a mask for each."""
    random, came = np.random.default_rng(FAULTS.index(fault)), Counter[str]()
    kinds = scenes(random, 10)
    options = ("--callers", "1024", "--every-captures", "1")
    with (
        _daemon(folder / fault, bundle, *options) as url,
        Camera(url, connect_timeout=30) as camera,
        Camera(url, max_retries=0, connect_timeout=30) as asking,
    ):
        for turn in range(tries):
            if time.monotonic() > until:
                break
            came["tried"] += 1
            camera.simulation.hold_scene(np.ones((28, 28), np.float32))
            _ready(camera)
            camera.simulation.hold_scene(kinds[KINDS[turn % len(KINDS)]][turn % 10].reshape(28, 28))
            with suppress(VeilcamError):
                asking.classify()
            time.sleep(random.uniform(0.2, 0.6))  # the next mask is shown by now
            camera.simulation.set_faults(Faults(panel=PanelFaults(**{fault: True})))
            for number in ("first", "second"):
                # A panel that fell asleep wakes with the reset: its second capture is sound.
                if fault == "asleep" and number == "second":
                    break
                try:
                    asking.classify()
                    came[f"answered {number}"] += 1
                except ApiError as error:
                    came[f"{error.code} {number}"] += 1
    return came


def all_rest_faults(
    folder: Path, bundle: Path, tries: int, minutes: float
) -> Mapping[str, Counter[str]]:
    """Ask five daemons at once, one for each fault, for so many minutes at most."""
    until = time.monotonic() + 60 * minutes
    with ThreadPoolExecutor(len(FAULTS)) as threads:
        found = [
            threads.submit(rest_faults, folder, bundle, fault, tries, until) for fault in FAULTS
        ]
        return {fault: each.result() for fault, each in zip(FAULTS, found, strict=True)}


@contextmanager
def engine(folder: Path, captures: int) -> Iterator[MaskedCamera]:
    """Yield the camera of a daemon as shipped, but for its rotation, in this process."""
    made: list[MaskedCamera] = []

    def noted(*given: Any, **more: Any) -> MaskedCamera:
        made.append(MaskedCamera(*given, **more))
        return made[-1]

    folder.mkdir()
    write_scene(folder / "scene.npy", np.full((28, 28), 255, np.uint8))
    settings = Settings(
        device="simulated",
        bundle=BUNDLE,
        scenes=(str(folder / "scene.npy"),),
        state_dir=folder / "state",
        rotation=EveryCaptures(captures=captures),
    )
    with patch.object(served_camera, "MaskedCamera", noted):
        service = daemon.build_service(settings)
    try:
        yield made[0]
    finally:
        service.stop()


class Once(ST7735R):
    """A panel whose window is written once."""

    def _write_window(self) -> None:
        spi = self._spi
        sent = 0

        class Half:
            def write(self, buffer: memoryview | bytes) -> None:
                nonlocal sent
                sent += 1
                if sent <= _TRANSFERS:
                    spi.write(buffer)

        self._spi = Half()  # type: ignore[assignment]
        try:
            super()._write_window()
        finally:
            self._spi = spi


_TRANSFERS = 6
"""Of a window that is written once."""


class Bench:
    """The driver on an emulated panel, and light that is what the window lets through."""

    name, full_scale, resets = "bench", 1.0, 0

    def __init__(self, driver: type[ST7735R]) -> None:
        self.now, self._camera = 0.0, GeometricCamera()
        self.panel = PanelEmulator(
            TABS["green"], crystal=Crystal(scan=0.0), reset_time=0.0, clock=lambda: self.now
        )
        self._driver = driver(
            *(self.panel, self.panel),
            camera=self._camera,
            tab=TABS["green"],
            sleep=lambda _: None,
            clock=lambda: self.now,
        )
        self.show, self.blank, self.close = self._driver.show, self._driver.blank, lambda: None

    def clock(self) -> float:
        """Monotonic time [s]."""
        return self.now

    @property
    def window(self) -> Levels:
        """What the window shows."""
        window = self._camera.window
        rows = slice(window.first_row, window.first_row + window.rows)
        columns = slice(window.first_column, window.first_column + window.columns)
        return self.panel.framebuffer()[rows, columns]

    def light(self, not_before: float, timeout: float) -> Light:  # noqa: ARG002 - never late
        """Expose once."""
        self.now = max(self.now, not_before) + 0.03
        return Light(float(np.square(self.window / 63).mean()), 1e-4)


def lost_transfers(every: int, captures: int, masks: Sequence[Levels], *, guarded: bool) -> int:
    """Count answers behind masks that are not there, while every so many-th transfer is lost.

    Args:
        every: number of transfers from one that is lost to the next; each phase is tried.
        captures: so many for each phase, with a mask each.
        masks: that take turns.
        guarded: whether masks are written twice after an opaque frame, or once over the last one.
    """
    wrong = 0
    for phase in range(every):
        bench = Bench(ST7735R if guarded else Once)
        for _ in range(phase):
            bench.panel.write(b"")
        device = Device(bench, bench, simulated=True)  # type: ignore[arg-type]
        guard = Guard(device, Fence(0.1), every=0.0, clock=bench.clock)
        bench.panel.faults = PanelFaults(lost=every)
        for capture in range(captures):
            levels = masks[capture % len(masks)]
            (guard if guarded else bench).show(levels)
            seen, there = bench.light(0.0, 1.0), np.array_equal(bench.window, levels)
            with suppress(PanelNotHidingError, UnsteadyLightError):
                if guarded:
                    guard.vouch(levels, seen, last=True)
                wrong += not there
    return wrong


def rates(folder: Path, seconds: float) -> Mapping[str, float]:
    """Return captures a second with the guard and without, and the latency of held answers [ms].

    One camera after the other, of one and of ten captures a mask; with and without take turns.
    """

    def uncovered(guard: Guard, _: Levels) -> None:
        guard.covered = True

    found: dict[str, float] = {}
    for captures, name in ((1, "one"), (10, "ten")):
        with engine(folder / name, captures) as camera:
            taken, took = {True: 0, False: 0}, {True: 0.0, False: 0.0}
            held: list[float] = []
            for turn in range(8):
                guarded = turn % 2 == 0
                with ExitStack() as without:
                    if not guarded:
                        without.enter_context(patch.object(Guard, "_cover", uncovered))
                        without.enter_context(patch.object(Guard, "vouch", lambda *_, **__: True))
                    camera.await_next()
                    begun, stop = time.perf_counter(), time.perf_counter() + seconds / 8
                    while time.perf_counter() < stop or taken[guarded] % captures:
                        asked = time.perf_counter()
                        camera.capture(release=False).done()
                        held += [time.perf_counter() - asked] if guarded else []
                        taken[guarded] += 1
                    took[guarded] += time.perf_counter() - begun
            found[f"guard_rate_{name}_capture{'s' * (captures > 1)}"] = (
                taken[True] / took[True] / (taken[False] / took[False])
            )
            found[f"captures_a_second_{name}"] = taken[True] / took[True]
            found[f"captures_a_second_{name}_without"] = taken[False] / took[False]
            if captures == 1:
                found["held_latency_ms"] = 1e3 * float(np.median(held))
    return found


def latencies(folder: Path, count: int) -> tuple[float, Array, Counter[str]]:
    """Return how well latencies tell a wall from a digit under a lamp that is switched: AUC.

    Args:
        folder: for the daemon's state.
        count: captures, half of each.

    Returns:
        The area, latencies of all answers [s], and what came of the captures.
    """
    random, came = np.random.default_rng(7), Counter[str]()
    kinds = scenes(random, 10)
    told: tuple[list[float], list[float]] = ([], [])
    options = ("--callers", "1024", "--every-captures", "1")
    with (
        _daemon(folder / "latencies", BUNDLE, *options) as url,
        Camera(url, max_retries=0, connect_timeout=30) as camera,
    ):
        _ready(camera)
        for turn in range(count):
            which = int(random.integers(2))
            scene = kinds["digit" if which else "wall"][turn % 10].reshape(28, 28)
            camera.simulation.hold_scene(scene)
            time.sleep(random.uniform(0.2, 0.4))
            switch = Timer(random.uniform(0, 0.4), _switch, (camera, random.random() < 0.5))
            if which and random.random() < 0.25:
                switch.start()
            begun = time.perf_counter()
            try:
                camera.classify()
                told[which].append(time.perf_counter() - begun)
                came[f"answered {which}"] += 1
            except ApiError as error:
                came[f"{error.code} {which}"] += 1
            if switch.is_alive():
                switch.join()
    one, other = (np.array(each) for each in told)
    ahead = (one[:, None] < other).mean() + 0.5 * (one[:, None] == other).mean()
    return float(max(ahead, 1 - ahead)), np.concatenate([one, other]), came


def _switch(camera: Camera, low: bool) -> None:
    camera.simulation.set_faults(Faults(light=LightFaults(lamp=0.1 if low else 1.0)))
