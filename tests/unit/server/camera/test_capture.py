"""Engine, drivers and emulators together, on a real clock: no measurement ever mixes two masks.

Each mask is one level all over, so a measurement tells which mask made it, or that it was several.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch

from veilcam_client.wire.rotation import EveryCaptures, RotationOff, RotationPolicy
from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Window
from veilcam_optics.simulation.operator import Response
from veilcam_server.camera.budget import ReleaseBudget
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.camera.capture import Fence, MaskedCapture
from veilcam_server.camera.epochs import Preparation
from veilcam_server.devices import Device, Exposure, SensorError
from veilcam_server.devices.imx477 import IMX477, ExposureRange
from veilcam_server.devices.raw import Raw, SensorMode
from veilcam_server.devices.reopening import ReopeningDisplay
from veilcam_server.devices.simulated.device import Conditions, SimulatedLight
from veilcam_server.devices.simulated.panel import Crystal, PanelEmulator
from veilcam_server.devices.simulated.picamera import CameraFaults, FakePicamera2
from veilcam_server.devices.simulated.scenes import Scenes
from veilcam_server.devices.st7735r import ST7735R
from veilcam_server.devices.st7735r_glass import TABS
from veilcam_server.errors import PanelNotHidingError, UnsteadyLightError
from veilcam_server.masks.pairs import load_pairs
from veilcam_server.masks.source import Terms
from veilcam_server.sealing.identity import DeviceKey
from veilcam_server.system.state_file import make_directory
from veilcam_training.bundle import Bundle, Pair
from veilcam_training.bundle.layers import Linear

CAMERA, EMBEDDING = Camera(window=Window(rows=9, columns=6)), Embedding(2, 3)
LEVELS = (12, 24, 36, 48, 60)
MODE = SensorMode(48, 66, line_time=6.25e-5, frame_duration=0.01)
SETTLE = 0.06
ROUNDING = 1e-3


class White:
    """A white scene."""

    def read(self) -> npt.NDArray[np.float32]:
        return np.ones((2, 2), np.float32)


class Plain:
    """Light that is the mean of the mask."""

    def response(self, weights: torch.Tensor) -> Response:
        return (weights.double().mean(),)

    def collect(self, scenes: torch.Tensor, response: Response) -> torch.Tensor:
        return response[0].expand(len(scenes), MODE.rows, MODE.columns).clone()


class Passed:
    """A self test that was passed: this light has no geometry to test by."""

    def run(self, device: Device, fence: Fence) -> float:
        return 0.0


def make_bundle() -> Bundle:
    pairs = tuple(
        Pair(
            levels=np.full(CAMERA.mask_shape, level, np.uint8),
            layers=(Linear(inputs=EMBEDDING.size, outputs=2),),
            weights={
                "0.weight": np.full((2, EMBEDDING.size), level, np.float32),
                "0.bias": np.zeros(2, np.float32),
            },
        )
        for level in LEVELS
    )
    return Bundle(
        task="levels",
        labels=("a", "b"),
        camera=CAMERA,
        scene=Scene(rows=2, columns=2),
        embedding=EMBEDDING,
        mode="pairs",
        pairs=pairs,
        digest="b0" * 32,
    )


@dataclass
class Rig:
    """An engine on emulated hardware."""

    directory: Path
    crystal: Crystal = field(default_factory=lambda: Crystal(scan=0.02, settle=0.03))
    exposures: ExposureRange = field(default_factory=lambda: ExposureRange(0.002))
    granted: float = SETTLE
    policy: RotationPolicy = field(default_factory=lambda: EveryCaptures(captures=1))
    faults: CameraFaults = field(default_factory=CameraFaults)
    shown: list[int] = field(default_factory=list)
    optics: Plain = field(default_factory=Plain)

    def __post_init__(self) -> None:
        self.panel = PanelEmulator(TABS["green"], crystal=self.crystal, reset_time=0.0)
        set_up = partial(
            ST7735R,
            *(self.panel, self.panel),
            camera=CAMERA,
            tab=TABS["green"],
            sleep=lambda _: None,
        )
        display = ReopeningDisplay("ST7735R", set_up)
        show = display.show

        def noted(levels: npt.NDArray[np.uint8]) -> object:
            shown = show(levels)
            if levels.any():
                self.shown.append(int(levels[0, 0]))
            return shown

        display.show = noted  # type: ignore[method-assign, assignment]
        self.light = SimulatedLight(
            self.panel,
            Scenes((White(),)),
            self.optics,
            camera=CAMERA,
            embedding=EMBEDDING,
            conditions=Conditions(exposure=self.exposures.start, snr_db=math.inf),
            mode=MODE,
            full_scale=1.2,
            seed=0,
        )
        self.frames: Callable[[float, float], Raw] = self.light
        sensor = IMX477(
            lambda: FakePicamera2(self._frames, mode=MODE, faults=self.faults),
            shape=EMBEDDING.shape,
            mode=MODE,
            exposures=self.exposures,
            full_scale=1.2,
        )
        make_directory(self.directory)
        budget, signer = ReleaseBudget(self.directory, 0), DeviceKey.open(self.directory)
        self.camera = MaskedCamera(
            Device(display, sensor, simulated=True),
            Preparation(
                load_pairs(make_bundle()),
                *(signer, lambda: Terms("none"), budget),
            ),
            EMBEDDING.shape,
            Passed(),
            fence=Fence(settle=self.granted, timeout=20.0),
            policy=self.policy,
        )
        self.camera.rotate()

    def _frames(self, begin: float, end: float) -> Raw:
        return self.frames(begin, end)

    def capture(self) -> tuple[int, MaskedCapture]:
        """A measurement, and the level of the mask that the engine says it was taken under."""
        captured = self.camera.capture(release=False)
        return self.shown[-1], captured


Rigged = Callable[..., Rig]


@pytest.fixture
def rigged(tmp_path: Path) -> Iterator[Rigged]:
    with ExitStack() as stack:

        def make(**arguments: object) -> Rig:
            rig = Rig(tmp_path / "state", **arguments)  # type: ignore[arg-type]
            stack.callback(rig.camera.stop)
            return rig

        yield make


def mixed(level: int, captured: MaskedCapture) -> bool:
    """Whether a measurement is of any other light than that through a mask of one level."""
    return bool(np.abs(captured.measurement - level / 63).max() > ROUNDING)


def test_every_measurement_is_of_its_own_mask_alone(rigged: Rigged) -> None:
    rig = rigged()
    for _ in range(8):
        level, captured = rig.capture()
        assert not mixed(level, captured)
        assert captured.exposure.started_after_shown_s >= SETTLE
    assert len(set(rig.shown)) > 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "crystal",
    [Crystal(scan=0.4, settle=0.0), Crystal(scan=0.0, settle=0.4)],
    ids=["late scan", "slow crystal"],
)
def test_panel_that_takes_longer_is_waited_for_and_refused_if_it_is_not(
    crystal: Crystal, rigged: Rigged
) -> None:
    patient = rigged(crystal=crystal, granted=0.41)
    for _ in range(3):
        assert not mixed(*patient.capture())
    patient.camera.stop()
    # Where it is not, the guard finds no opaque frame that is dark.
    hasty = rigged(crystal=crystal, granted=0.0)
    with pytest.raises((PanelNotHidingError, UnsteadyLightError)):
        hasty.capture()


def test_old_frames_in_the_queue_are_passed_over(rigged: Rigged) -> None:
    rig = rigged()
    for _ in range(4):
        rig.faults.stale = 3
        level, captured = rig.capture()
        # Where the machine stalls, one that was asked for early began late enough by itself.
        assert rig.faults.stale < 3
        assert captured.exposure.started_after_shown_s >= SETTLE
        assert not mixed(level, captured)


def test_frame_of_an_exposure_not_yet_applied_is_passed_over(
    rigged: Rigged, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: list[Exposure] = []
    original = IMX477.capture

    def noted(self: IMX477, not_before: float, timeout: float) -> Exposure:
        taken.append(original(self, not_before, timeout))
        return taken[-1]

    monkeypatch.setattr(IMX477, "capture", noted)
    # Dim from the first frame on: the camera sees before it is asked.
    rig = rigged(exposures=ExposureRange(0.001, factor=4), optics=Dim())
    for _ in range(4):
        level, captured = rig.capture()
        np.testing.assert_allclose(captured.measurement, 0.1 * level / 63, atol=2e-3)
    # Each step waited for controls that come into force two frames later.
    assert taken[0].integration == pytest.approx(0.001)
    assert taken[-1].integration == pytest.approx(0.004, abs=MODE.line_time)


class Dim(Plain):
    """A tenth of the light."""

    def collect(self, scenes: torch.Tensor, response: Response) -> torch.Tensor:
        return 0.1 * super().collect(scenes, response)


def test_frame_that_is_given_out_twice_is_an_error_and_not_a_measurement(rigged: Rigged) -> None:
    rig = rigged()
    rig.capture()
    rig.faults.stuck = True
    with pytest.raises(SensorError, match="same frame"):
        rig.capture()
    rig.faults.stuck = False
    assert not mixed(*rig.capture())


def test_change_that_is_asked_for_during_readout_waits(rigged: Rigged) -> None:
    rig = rigged(policy=RotationOff())
    changing: list[threading.Thread] = []

    def meddling(begin: float, end: float) -> Raw:
        if not changing:
            changing.append(threading.Thread(target=rig.camera.rotate))
            changing[0].start()
            changing[0].join(0.1)
            assert changing[0].is_alive()
        return rig.light(begin, end)

    rig.frames = meddling
    before = rig.shown[-1]
    captured = rig.camera.capture(release=False)
    changing[0].join()
    assert rig.shown[-1] != before
    assert not mixed(before, captured)


def test_mask_that_is_changed_behind_the_engine_s_back_mixes_by_rows(rigged: Rigged) -> None:
    """The fake camera reads out row by row: what the fence is there for does exist."""
    rig = rigged(crystal=Crystal(scan=0.0, settle=0.0), policy=RotationOff())
    before = rig.shown[-1]
    calls: list[float] = []

    def meddling(begin: float, end: float) -> Raw:
        calls.append(begin)
        if len(calls) == 2:  # the last row's exposure
            rig.camera._device.display.blank()
            rig.panel._turns[-1] = replace(rig.panel._turns[-1], at=begin - 1e-6)
        return rig.light(begin, end)

    rig.frames = meddling
    captured = rig.camera.capture(release=False)
    assert mixed(before, captured)
    assert captured.measurement[0, 0] > captured.measurement[1, 0]
