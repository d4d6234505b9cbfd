"""The optical self test on emulated hardware: what it must pass, and every fault it must find."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch
from tests.unit.server.devices.clock import Clock

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.wire.captures import Prediction
from veilcam_client.wire.simulation import PanelFaults
from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.simulation.operator import Response
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_server.camera.budget import ReleaseBudget
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.camera.capture import Fence
from veilcam_server.camera.epochs import Preparation
from veilcam_server.camera.self_test import OpticalSelfTest
from veilcam_server.devices import Device, DisplayError, SensorError
from veilcam_server.devices.base import Exposure, Levels, Light, Measurement, Sensor
from veilcam_server.devices.imx477 import IMX477, ExposureRange
from veilcam_server.devices.raw import SensorMode
from veilcam_server.devices.reopening import ReopeningDisplay
from veilcam_server.devices.simulated.device import Conditions, SimulatedLight
from veilcam_server.devices.simulated.panel import Crystal, PanelEmulator
from veilcam_server.devices.simulated.picamera import CameraFaults, FakePicamera2
from veilcam_server.devices.simulated.scenes import Scenes
from veilcam_server.devices.st7735r import ST7735R
from veilcam_server.devices.st7735r_glass import TABS
from veilcam_server.errors import NotReadyError, SelfTestError, UndecidedError
from veilcam_server.masks.source import Evidence, Mask, Terms
from veilcam_server.sealing.identity import DeviceKey
from veilcam_server.settings import SELF_TEST

pytestmark = pytest.mark.numerical

CAMERA, SCENE, EMBEDDING = Camera(), Scene(rows=5, columns=5), Embedding(12, 16)
FENCE = Fence(settle=0.05)
CAPTURES = SELF_TEST
"""Of one test."""
LIGHT, REPEATED = Embedding(24, 32), 2
"""How finely light is computed, and how often each value is repeated along both axes."""
MODE = SensorMode(48, 64, line_time=0.0, frame_duration=0.0)
RNG = np.random.default_rng(3)
PICTURE = RNG.random(SCENE.shape, np.float32)


class Rays:
    """The light of training's optics, on raw pixels; ``floor`` of it gets past an opaque panel."""

    operator = TransferOperator(CAMERA, SCENE, LIGHT, step=20e-6, dtype=torch.float32)

    def __init__(self, floor: float = 0.0) -> None:
        self.floor = floor

    def response(self, weights: torch.Tensor) -> Response:
        with torch.no_grad():
            floor = math.sqrt(self.floor)
            return (self.operator(floor + (1 - floor) * weights.float()),)

    def collect(self, scenes: torch.Tensor, response: Response) -> torch.Tensor:
        light = (scenes.flatten(1) @ response[0]).reshape(len(scenes), *LIGHT.shape)
        return light.repeat_interleave(REPEATED, 1).repeat_interleave(REPEATED, 2)


OPEN = Rays().collect(torch.ones(1, *SCENE.shape), Rays().response(torch.ones(CAMERA.mask_shape)))
FULL_SCALE = 1.1 * float(OPEN.max())


@dataclass
class Rig:
    """A driver on an emulated panel, light, and a camera, on a clock of their own."""

    tab: str = "green"
    driver: str = "green"
    faults: PanelFaults = field(default_factory=PanelFaults)
    floor: float = 0.0
    settle: float = 0.03
    picture: npt.NDArray[np.float32] = field(default_factory=PICTURE.copy)
    snr_db: float = 40.0
    before: Callable[[int], None] = lambda _: None
    """Called with the number of each exposure."""
    clock: Callable[[], float] = field(default_factory=Clock)
    sleep: Callable[[float], None] | None = None
    """By default the clock's own."""

    def __post_init__(self) -> None:
        self.exposures = 0
        sleep = self.sleep
        if isinstance(self.clock, Clock):
            sleep = self.clock.sleep
        assert sleep is not None
        self.panel = PanelEmulator(
            TABS[self.tab],
            crystal=Crystal(settle=self.settle),
            reset_time=0.0,
            clock=self.clock,
            faults=self.faults,
        )
        set_up = partial(
            ST7735R,
            *(self.panel, self.panel),
            camera=CAMERA,
            tab=TABS[self.driver],
            sleep=lambda _: None,
            clock=self.clock,
        )
        light = SimulatedLight(
            self.panel,
            Scenes((self,), clock=self.clock),
            Rays(self.floor),
            camera=CAMERA,
            embedding=EMBEDDING,
            conditions=Conditions(exposure=0.01, snr_db=self.snr_db),
            mode=MODE,
            full_scale=FULL_SCALE,
            seed=1,
        )

        def frames(begin: float, end: float) -> npt.NDArray[np.uint16]:
            self.before(self.exposures)
            self.exposures += 1
            return light(begin, end)

        self.camera_faults = CameraFaults()
        sensor = IMX477(
            lambda: FakePicamera2(
                frames,
                mode=MODE,
                faults=self.camera_faults,
                clock=self.clock,
                sleep=sleep,
            ),
            shape=EMBEDDING.shape,
            mode=MODE,
            exposures=ExposureRange(0.01),
            full_scale=FULL_SCALE,
            clock=self.clock,
        )
        self.device = Device(
            ReopeningDisplay("ST7735R", set_up, clock=self.clock),
            sensor,
            simulated=True,
        )
        self.device.display.blank()

    def read(self) -> npt.NDArray[np.float32]:
        return self.picture

    def command(self, code: int) -> None:
        """Send a command that the driver knows nothing of."""
        self.panel.data(False)
        self.panel.write(bytes([code]))

    def test(self, seed: int = 7) -> None:
        OpticalSelfTest(
            CAMERA, SCENE, EMBEDDING, generator=np.random.default_rng(seed), clock=self.clock
        ).run(self.device, FENCE)


SPOT = np.zeros(SCENE.shape, np.float32)
SPOT[1, 3] = 1.0


@pytest.mark.parametrize("tab", TABS)
@pytest.mark.parametrize("picture", [PICTURE, SPOT, np.ones(SCENE.shape, np.float32)])
def test_panel_that_does_what_it_is_told_passes(tab: str, picture: npt.NDArray[np.float32]) -> None:
    rig = Rig(tab, tab, picture=picture)
    rig.test()
    assert rig.exposures == CAPTURES
    # It leaves the panel as the safe state has it.
    assert not rig.panel.framebuffer().any()


@pytest.mark.parametrize("seed", range(20))
def test_any_pattern_passes(seed: int) -> None:
    Rig(snr_db=25.0).test(seed)


def test_panel_with_poor_contrast_passes_until_it_hides_too_little() -> None:
    Rig(floor=0.3).test()
    with pytest.raises(SelfTestError, match="does not hide the scene"):
        Rig(floor=0.7).test()


@pytest.mark.parametrize(
    "fault",
    [
        pytest.param(PanelFaults(dead=True), id="dead"),
        pytest.param(PanelFaults(lost=1), id="every write lost"),
        pytest.param(PanelFaults(lost=2), id="every second write lost"),
    ],
)
def test_panel_that_is_transparent_is_found(fault: PanelFaults) -> None:
    with pytest.raises(SelfTestError, match="does not hide the scene") as caught:
        Rig(faults=fault).test()
    assert not isinstance(caught.value, UndecidedError)


@pytest.mark.parametrize("code", [0x28, 0x10, 0x01], ids=["off", "asleep", "reset"])
@pytest.mark.parametrize("moment", [-1, 0, 3, 6, 7])
def test_panel_that_goes_off_or_to_sleep_is_found_whenever_it_does(code: int, moment: int) -> None:
    rig = Rig()
    if moment < 0:
        rig.command(code)
    rig.before = lambda number: rig.command(code) if number == moment else None
    with pytest.raises(SelfTestError):
        rig.test()


@pytest.mark.parametrize("kept", range(1, CAPTURES - 1))
def test_panel_that_is_stuck_is_found_from_wherever_it_sticks(kept: int) -> None:
    """After so many pictures it stays as it is."""
    rig = Rig()

    def stick(number: int) -> None:
        if number == kept:
            rig.panel.write = lambda buffer: None  # type: ignore[method-assign]

    rig.before = stick
    with pytest.raises(SelfTestError):
        rig.test()


@pytest.mark.parametrize("lost", [2, 3, 4, 5, 6])
def test_lost_writes_are_found(lost: int) -> None:
    with pytest.raises(SelfTestError):
        Rig(faults=PanelFaults(lost=lost)).test()


def test_one_lost_pattern_is_found() -> None:
    rig = Rig()
    show = rig.device.display.show
    shown: list[int] = []

    def lossy(levels: Levels) -> object:
        shown.append(1)
        # The fifth pattern is the random quarter again.
        return show(levels if len(shown) != 5 else np.zeros_like(levels))

    rig.device.display.show = lossy  # type: ignore[method-assign, assignment]
    with pytest.raises(SelfTestError, match="does not show what it is told"):
        rig.test()


@pytest.mark.parametrize(("panel", "driver"), [("black", "red"), ("red", "black")])
@pytest.mark.parametrize("picture", [PICTURE, SPOT])
def test_tab_that_turns_the_mask_is_found(
    panel: str, driver: str, picture: npt.NDArray[np.float32]
) -> None:
    with pytest.raises(SelfTestError, match="turned or mirrored: check --panel-tab"):
        Rig(panel, driver, picture=picture).test()


def test_tab_that_shifts_the_mask_is_left_to_the_calibration() -> None:
    """A shifted mask in front of an unknown scene is a mask in front of a shifted one."""
    Rig("green", "red").test()


def test_embedding_too_coarse_to_see_where_a_shadow_is_passes() -> None:
    rig = Rig("black", "red")
    test = OpticalSelfTest(CAMERA, SCENE, Embedding(2, 2), clock=rig.clock)
    assert min(test._moved) < 2
    binned = replace(rig.device, sensor=_Binned(rig.device.sensor))
    test.run(binned, FENCE)


class _Binned:
    """A sensor with larger boxes."""

    def __init__(self, sensor: Sensor) -> None:
        self._sensor = sensor
        self.name, self.full_scale, self.close = sensor.name, sensor.full_scale, sensor.close

    def capture(self, not_before: float, timeout: float) -> Exposure:
        exposure = self._sensor.capture(not_before, timeout)
        embedding = exposure.embedding.reshape(2, 6, 2, 8).mean((1, 3))
        return replace(exposure, embedding=embedding)

    def light(self, not_before: float, timeout: float) -> Light:
        return self._sensor.light(not_before, timeout)


def test_dark_room_decides_nothing() -> None:
    rig = Rig(picture=np.zeros(SCENE.shape, np.float32))
    with pytest.raises(UndecidedError, match="too dark"):
        rig.test()
    rig.picture = PICTURE
    rig.test()


def test_light_that_goes_out_halfway_decides_nothing() -> None:
    rig = Rig()

    def out(number: int) -> None:
        if number == 5:
            rig.picture = np.zeros(SCENE.shape, np.float32)

    rig.before = out
    with pytest.raises(UndecidedError, match="too dark"):
        rig.test()


def test_light_that_changes_decides_nothing() -> None:
    rig = Rig()

    def brighter(number: int) -> None:
        rig.picture = PICTURE * (0.5 + 0.06 * number)

    rig.before = brighter
    with pytest.raises(UndecidedError, match="changes too much"):
        rig.test()


def test_crystal_slower_than_the_fence_is_found() -> None:
    with pytest.raises(SelfTestError):
        Rig(settle=0.5).test()


def test_camera_that_fails_is_not_called_the_panels_failure() -> None:
    rig = Rig()
    rig.camera_faults.hangs = 1
    with pytest.raises(SensorError):
        rig.test()


def test_patterns_cannot_be_foreseen_and_are_not_told() -> None:
    shown: list[list[Levels]] = []
    for _ in range(2):
        rig = Rig()
        show = rig.device.display.show
        patterns: list[Levels] = []
        shown.append(patterns)

        def noted(
            levels: Levels, patterns: list[Levels] = patterns, show: Callable[..., object] = show
        ) -> object:
            patterns.append(levels.copy())
            return show(levels)

        rig.device.display.show = noted  # type: ignore[method-assign, assignment]
        test = OpticalSelfTest(CAMERA, SCENE, EMBEDDING, clock=rig.clock)
        test.run(rig.device, FENCE)
        assert "array" not in repr(vars(test))
    first, second = shown
    assert not np.array_equal(first[1], second[1])
    # The random ones aside, the same is shown every time.
    assert np.array_equal(first[3], second[3])


class Bundled:
    """A source of random masks, which nobody reads."""

    renewable = True

    marks: frozenset[str] = frozenset()
    bundle = "b0" * 32

    def make(self, key: EpochKey, avoid: frozenset[str]) -> Mask:
        levels = np.random.default_rng(list(key.levels())).integers(
            0, 64, CAMERA.mask_shape, np.uint8
        )
        return Mask(levels, Unasked())


class Unasked:
    """Reads nothing."""

    def classify(self, measurement: Measurement) -> Prediction:
        raise AssertionError

    def evidence(self, measurement: Measurement) -> Evidence:
        raise AssertionError

    def erase(self) -> None:
        pass


@pytest.mark.slow
def test_engine_whose_bus_breaks_tests_its_panel_again(tmp_path: Path) -> None:
    """The whole way on a real clock: driver, re-initialisation, test, mask, capture."""
    rig = Rig(settle=0.002, clock=time.monotonic, sleep=time.sleep)
    budget = ReleaseBudget(tmp_path, 0)
    camera = MaskedCamera(
        rig.device,
        Preparation(Bundled(), DeviceKey.open(tmp_path), lambda: Terms("none"), budget),
        EMBEDDING.shape,
        OpticalSelfTest(CAMERA, SCENE, EMBEDDING),
        fence=Fence(settle=0.02),
    )
    camera.rotate()
    epoch = camera.capture(release=False).epoch
    # One more before each mask: its opaque frame.
    assert rig.exposures == CAPTURES + 2
    write, mask = rig.panel.write, rig.panel.framebuffer()

    def breaks(buffer: memoryview | bytes) -> None:
        rig.panel.write = write  # type: ignore[method-assign]
        raise OSError(5, "Input/output error")

    rig.panel.write = breaks  # type: ignore[method-assign]
    with pytest.raises(DisplayError, match="could not be changed"):
        camera.rotate()
    assert np.array_equal(rig.panel.framebuffer(), mask)
    assert rig.exposures == CAPTURES + 3
    # The panel was set up anew: proof first, then the same mask, and only then a capture.
    assert camera.capture(release=False).epoch == epoch
    assert rig.exposures == 2 * CAPTURES + 5
    assert np.array_equal(rig.panel.framebuffer(), mask)
    # Power fails while it is set up anew after the next break: no capture any more.
    rig.panel.write = breaks  # type: ignore[method-assign]
    rig.panel.faults = PanelFaults(dead=True)
    with pytest.raises(DisplayError):
        camera.rotate()
    with pytest.raises(NotReadyError, match="does not hide the scene"):
        camera.capture(release=False)
    assert camera.state[0] == "safe"
    assert rig.exposures == 3 * CAPTURES + 6
    rig.panel.faults = PanelFaults()
    camera.stop()
