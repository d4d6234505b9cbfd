"""The camera's driver on a fake picamera2: what a measurement is, when it was, and failures."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from veilcam_optics.propagation.sampling import area_average
from veilcam_server.devices import (
    DeviceMissingError,
    Exposure,
    SensorError,
    SensorHungError,
)
from veilcam_server.devices.imx477 import HALF, IMX477, ExposureRange
from veilcam_server.devices.picamera import open_picamera2
from veilcam_server.devices.raw import Raw, SensorMode
from veilcam_server.devices.reopening import ReopeningSensor
from veilcam_server.devices.simulated.picamera import CameraFaults, FakePicamera2

from .clock import Clock

MODE = SensorMode(60, 82, line_time=1e-4, frame_duration=0.025)
SHAPE = (4, 5)
FIXED = ExposureRange(0.01)


class Bench:
    """A driver on a camera whose light is the number of electrons that a level gathers."""

    def __init__(
        self,
        *,
        shape: tuple[int, ...] = SHAPE,
        mode: SensorMode = MODE,
        exposures: ExposureRange = FIXED,
        full_scale: float = 1.0,
        faults: CameraFaults | None = None,
    ) -> None:
        self.clock, self.mode = Clock(), mode
        self.faults = faults or CameraFaults()
        self.cameras: list[FakePicamera2] = []
        self.lit: list[tuple[float, float]] = []
        self.level: Callable[[float], float] = lambda _: 100_000.0
        start = partial(
            IMX477,
            self.open,
            shape=shape,
            mode=mode,
            exposures=exposures,
            full_scale=full_scale,
            clock=self.clock,
        )
        self.sensor = ReopeningSensor("IMX477", full_scale, start, clock=self.clock)
        with self.sensor._part.open():
            pass

    def open(self) -> FakePicamera2:
        camera = FakePicamera2(
            self.light, mode=self.mode, faults=self.faults, clock=self.clock, sleep=self.clock.sleep
        )
        self.cameras.append(camera)
        return camera

    def light(self, begin: float, end: float) -> Raw:
        self.lit.append((begin, end))
        level = self.level(end) * (end - begin) + 256
        return np.full((self.mode.rows, self.mode.columns), min(round(level), 4095), np.uint16)

    def capture(self, after: float = 0.0, timeout: float = 5.0) -> Exposure:
        return self.sensor.capture(self.clock.now + after, timeout)


def test_measurement_is_the_light_without_the_black_level() -> None:
    bench = Bench(full_scale=2.0)
    embedding = bench.capture().embedding
    assert embedding.shape == SHAPE
    assert embedding.dtype == np.float32
    np.testing.assert_allclose(embedding, 2.0 * 1000 / (4095 - 256), rtol=1e-6)


def test_pixels_are_averaged_where_they_are() -> None:
    bench = Bench()
    frame = np.random.default_rng(4).integers(0, 4000, (60, 82), np.uint16)
    bench.cameras[0]._light = lambda *_: frame
    mean = area_average(torch.from_numpy(frame.astype(float)), *SHAPE).numpy()
    np.testing.assert_allclose(bench.capture().embedding, (mean - 256) / (4095 - 256), rtol=1e-6)


@pytest.mark.parametrize("order", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_channels_are_told_apart_as_the_format_lays_them_out(order: str) -> None:
    bench = Bench(shape=(3, *SHAPE), faults=CameraFaults(format=f"S{order}12"))
    levels = {"R": 300, "G": 600, "B": 900}
    quad = np.array([levels[colour] + 256 for colour in order], np.uint16).reshape(2, 2)
    bench.cameras[0]._light = lambda *_: np.tile(quad, (30, 41))
    seen = bench.capture().embedding
    assert seen.shape == (3, *SHAPE)
    for channel, level in zip(seen, levels.values(), strict=True):
        np.testing.assert_allclose(channel, level / (4095 - 256), rtol=1e-6)


def test_light_of_a_frame_is_its_mean_at_the_exposure_to_begin_with() -> None:
    bench = Bench(full_scale=2.0, exposures=ExposureRange(0.002, factor=8))
    frame = np.full((60, 82), 256 + 384, np.uint16)
    bench.cameras[0]._light = lambda *_: frame
    exposure = bench.capture()
    assert exposure.light.mean == pytest.approx(384 / 3839)
    # The next exposure is longer: a frame that tells of light takes it as it comes.
    asked = bench.cameras[0]._controls[-1][1]["ExposureTime"] / 1e6
    assert asked > 0.002
    lights = [bench.sensor.light(bench.clock.now, 1.0) for _ in range(4)]
    assert lights[0].mean == pytest.approx(384 / 3839)
    assert lights[-1].mean == pytest.approx(0.002 / asked * 384 / 3839, rel=0.05)
    assert lights[-1].noise < lights[0].noise
    frame[:] = 4095
    assert bench.sensor.light(bench.clock.now, 1.0).saturated
    frame[:] = 256
    assert bench.sensor.light(bench.clock.now, 1.0).dark
    # Neither of them changed what is asked for.
    assert bench.cameras[0]._controls[-1][1]["ExposureTime"] / 1e6 == asked


def test_exposure_tells_when_its_rows_collected_light() -> None:
    bench = Bench()
    asked = bench.clock.now + 0.5
    exposure = bench.sensor.capture(asked, 5.0)
    begin, end = bench.lit[0]
    assert exposure.started_at == pytest.approx(begin, abs=1e-9)
    assert exposure.ended_at == pytest.approx(end + 59e-4, abs=1e-9)
    assert exposure.integration == pytest.approx(0.01)
    assert asked <= exposure.started_at < asked + 0.025
    assert exposure.ended_at <= bench.clock.now


@pytest.mark.parametrize("asked", [100.1 + step * 0.00317 for step in range(20)])
def test_no_frame_begins_before_the_fence(asked: float) -> None:
    assert Bench().sensor.capture(asked, 5.0).started_at >= asked


def test_mode_is_pinned_and_all_that_adapts_is_off() -> None:
    bench = Bench(exposures=ExposureRange(0.05))
    asked = bench.cameras[0]._configuration
    assert asked["raw"]["size"] == asked["sensor"]["output_size"] == (82, 60)
    assert asked["sensor"]["bit_depth"] == 12
    assert not asked["queue"]
    _, controls = bench.cameras[0]._controls[-1]
    assert not controls["AeEnable"]
    assert not controls["AwbEnable"]
    assert controls["NoiseReductionMode"] == 0
    assert controls["AnalogueGain"] == 1.0
    assert controls["ExposureTime"] == 50_000
    assert controls["FrameDurationLimits"][0] > 50_000  # or it would be cut to the frame
    assert HALF.size == (2028, 1520)


@pytest.mark.parametrize("layout", ["SRGGB12", "SBGGR12", "SRGGB16"])
def test_both_layouts_of_raw_pixels_are_read(layout: str) -> None:
    embedding = Bench(faults=CameraFaults(format=layout)).capture().embedding
    np.testing.assert_allclose(embedding, 1000 / (4095 - 256), rtol=1e-6)


@pytest.mark.parametrize("layout", ["RGGB_PISP_COMP1", "SRGGB12_CSI2P", "SRGGB10", "XBGR8888"])
def test_compressed_and_packed_frames_are_refused(layout: str) -> None:
    faults = CameraFaults(format=layout)
    with pytest.raises(SensorError, match=f"{layout}.*uncompressed"):
        Bench(faults=faults)


def test_camera_without_raw_frames_is_refused() -> None:
    clock = Clock()

    class Webcam(FakePicamera2):
        def configure(self, camera_config: dict[str, Any]) -> None:
            super().configure(camera_config)
            self._configuration |= {"raw": None, "sensor": None}

        def set_controls(self, controls: dict[str, Any]) -> None:
            raise RuntimeError("Control AnalogueGain is not advertised by libcamera")

    with pytest.raises(SensorError, match=r"gives no raw frames: use a Raspberry Pi HQ camera"):
        IMX477(
            lambda: Webcam(lambda *_: np.zeros((60, 82), np.uint16), mode=MODE, clock=clock),
            shape=SHAPE,
            mode=MODE,
            clock=clock,
        )


@pytest.mark.parametrize("exposure", [0.0001, 0.001, 0.01])
def test_exposure_of_whole_lines_is_taken_though_images_were_amplified(exposure: float) -> None:
    mode = replace(MODE, line_time=15.17e-6)
    bench = Bench(mode=mode, exposures=ExposureRange(exposure))
    measurement = bench.capture()
    assert bench.cameras[0]._before is not None
    assert bench.cameras[0]._before.get_metadata()["DigitalGain"] != 1
    assert measurement.integration == pytest.approx(exposure, abs=mode.line_time)
    expected = 100_000 * exposure / (4095 - 256)
    np.testing.assert_allclose(measurement.embedding, expected, rtol=0.1)


def test_another_mode_is_refused_and_the_camera_let_go() -> None:
    clock = Clock()
    light = np.zeros((60, 82), np.uint16)
    camera = FakePicamera2(lambda *_: light, mode=replace(MODE, bit_depth=10), clock=clock)
    with pytest.raises(SensorError, match="did not take the mode 82 x 60, 12 bit"):
        IMX477(lambda: camera, shape=SHAPE, mode=MODE, clock=clock)
    assert camera.closed


def test_old_frames_and_those_of_another_exposure_or_gain_are_passed_over() -> None:
    bench = Bench()
    before = bench.capture()
    bench.faults.stuck = True
    with pytest.raises(SensorError, match="the same frame again"):
        bench.capture()
    bench.faults.stuck = False
    bench.clock.sleep(1.0)
    after = bench.capture()
    assert after.started_at > before.ended_at + 1.0
    assert len(bench.cameras) == 2
    assert bench.cameras[0].closed


def test_exposure_that_never_applies_ends_in_a_timeout_that_says_so() -> None:
    bench = Bench(exposures=ExposureRange(0.01, factor=8))
    bench.level = lambda _: 10_000.0
    bench.faults.deaf = True
    bench.capture()  # asks for a longer one
    with pytest.raises(SensorError, match="exposure asked for was not applied"):
        bench.capture(timeout=0.3)


def test_wrong_gain_is_never_used() -> None:
    bench = Bench(faults=CameraFaults(gain=1.5))
    with pytest.raises(SensorError, match=r"gain was 1\.500, not 1"):
        bench.capture(timeout=0.3)


def test_dim_scene_is_exposed_longer_within_bounds_and_reads_the_same() -> None:
    bench = Bench(exposures=ExposureRange(0.002, factor=4))
    first, second, third = (bench.capture() for _ in range(3))
    asked = [each.integration for each in (first, second, third)]
    assert asked == pytest.approx([0.002, 0.008, 0.008])
    np.testing.assert_allclose(first.embedding, second.embedding, rtol=1e-2)


def test_fixed_exposure_stays() -> None:
    bench = Bench(exposures=ExposureRange(0.002))
    bench.level = lambda _: 1_000.0
    assert {bench.capture().integration for _ in range(4)} == {0.002}


def test_saturated_frame_is_taken_again_with_less_light() -> None:
    bench = Bench(exposures=ExposureRange(0.01, factor=16))
    bench.level = lambda _: 1_000_000.0
    exposure = bench.capture()
    assert exposure.integration == pytest.approx(0.0025)
    np.testing.assert_allclose(exposure.embedding, 10_000 / (4095 - 256), rtol=1e-2)


def test_light_that_is_too_bright_for_any_exposure_is_an_error() -> None:
    bench = Bench(exposures=ExposureRange(0.01, factor=4))
    bench.level = lambda _: 1e9
    with pytest.raises(SensorError, match=r"saturated at 2\.5 ms"):
        bench.capture()
    bench.level = lambda _: 100_000.0
    assert np.max(bench.capture().embedding) < 1
    assert len(bench.cameras) == 1  # light is no fault of the camera's


def test_camera_that_hangs_is_closed_and_opened_again() -> None:
    bench = Bench()
    bench.faults.hangs = 1
    began = bench.clock.now
    with pytest.raises(SensorError, match=r"it gave no frame in time"):
        bench.capture(timeout=2.0)
    assert bench.clock.now - began == pytest.approx(2.0)
    assert bench.cameras[0].closed
    assert not bench.cameras[0].started
    bench.capture()
    assert len(bench.cameras) == 2


def test_camera_that_comes_back_as_another_one_is_an_error() -> None:
    bench = Bench()
    bench.faults.hangs = 1
    with pytest.raises(SensorError):
        bench.capture(timeout=0.1)
    bench.faults.format = "SRGGB12_CSI2P"
    with pytest.raises(SensorError, match="uncompressed"):
        bench.capture()
    assert bench.cameras[1].closed
    bench.faults.format = None
    bench.clock.sleep(1.0)
    bench.capture()


def test_exceptions_of_picamera2_tell_nothing_of_the_frame() -> None:
    bench = Bench()

    def fail(*_: object) -> Raw:
        raise ValueError("pixels 4095 4095 4095")

    bench.cameras[0]._light = fail
    with pytest.raises(SensorError) as caught:
        bench.capture()
    assert "4095" not in str(caught.value)
    assert caught.value.__context__ is None


def test_camera_that_cannot_even_be_closed_is_not_opened_again_before_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("veilcam_server.devices.imx477._CLOSING", 0.01)
    bench, let_go = Bench(), threading.Event()
    bench.cameras[0].close = let_go.wait  # type: ignore[method-assign, assignment]
    bench.faults.hangs = 1
    with pytest.raises(SensorError):
        bench.capture(timeout=0.1)
    for _ in range(3):
        bench.clock.sleep(100.0)
        with pytest.raises(SensorHungError, match="start the daemon again") as caught:
            bench.capture()
        assert caught.value.remedy == "restart"
    assert len(bench.cameras) == 1
    let_go.set()
    closing = bench.sensor._part._hung
    assert isinstance(closing, IMX477)
    assert closing._closing is not None
    closing._closing.join(20)
    bench.capture()
    assert len(bench.cameras) == 2


def test_nothing_of_a_raw_frame_stays_in_memory() -> None:
    bench, arrays = Bench(), []
    camera = bench.cameras[0]
    take = camera._take

    def watched(*arguments: object) -> object:
        request = take(*arguments)  # type: ignore[arg-type]
        make = request.make_array

        def make_array(name: str) -> np.ndarray:
            arrays.append(make(name))
            return arrays[-1]

        request.make_array = make_array  # type: ignore[method-assign]
        return request

    camera._take = watched  # type: ignore[method-assign, assignment]
    bench.capture()
    (array,) = arrays
    assert not array.view(np.uint16)[:, : MODE.columns].any()


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (RuntimeError("Camera __init__ sequence did not complete."), "whatever else uses it"),
        (RuntimeError("No camera number 0 found - use ..."), "no camera 0.*cable"),
        (IndexError("list index out of range"), "no camera 0.*cable"),
        (RuntimeError("Could not open any dmaHeap device"), "dma_heap.*group video"),
        (PermissionError(13, "Permission denied"), "dma_heap.*group video"),
    ],
)
def test_camera_that_cannot_be_opened_says_what_to_do(
    error: Exception, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: int) -> None:
        raise error

    monkeypatch.setitem(sys.modules, "picamera2", SimpleNamespace(Picamera2=fail))
    with pytest.raises(DeviceMissingError, match=message):
        open_picamera2()


def test_what_a_missing_package_is_needed_for_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: str) -> None:
        raise ModuleNotFoundError("No module named 'libcamera'", name="libcamera")

    message = "not installed, which picamera2 needs: sudo apt install python3-libcamera"

    monkeypatch.setattr("veilcam_server.devices.extras.importlib.import_module", fail)
    with pytest.raises(DeviceMissingError, match=message):
        open_picamera2()
