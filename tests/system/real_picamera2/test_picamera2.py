"""The driver on the real picamera2: what the fake one cannot show."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import libcamera
import numpy as np
import pytest
import torch

from veilcam_optics.propagation.sampling import area_average
from veilcam_server.devices import DeviceMissingError, SensorError
from veilcam_server.devices.imx477 import IMX477
from veilcam_server.devices.picamera import open_picamera2

from .conftest import SHAPE, Driver, wait_until
from .virtual_picamera2 import BUFFERS, MODE, PlainPicamera2, RawPicamera2, RawRequest, instead_of

pytestmark = [
    # picamera2 still calls Thread.setDaemon(), and leaves a pipe open where it finds no camera.
    pytest.mark.filterwarnings("ignore:setDaemon:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning"),
    # Threads that die are what some of these tests are about.
    pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning"),
]


def fail(*_: object) -> None:
    raise ValueError("in picamera2's own thread")


def kill_loop(camera: Any) -> None:
    camera.pre_callback = fail
    loop = camera._preview.thread
    wait_until(lambda: not loop.is_alive())


def kill_listener(camera: Any) -> None:
    listener = camera._cm.thread
    with patch.object(RawRequest, "__init__", fail):
        wait_until(lambda: not listener.is_alive())


def hang(camera: Any) -> None:
    camera.held = [camera.capture_request(wait=5.0) for _ in range(BUFFERS)]


def forget(camera: Any) -> None:
    camera.told = {}
    frames = camera.frames
    wait_until(lambda: bool(camera.frames > frames + 2 * BUFFERS))


@pytest.fixture
def bench() -> Iterator[Driver]:
    with instead_of(RawPicamera2):
        bench = Driver(open_picamera2, MODE)
        yield bench
        bench.sensor.close()


def test_one_that_is_in_use_says_so_and_goes_on(bench: Driver) -> None:
    with pytest.raises(DeviceMissingError, match="camera 0 cannot be opened: end whatever else"):
        open_picamera2()
    bench.sensor.capture(0.0, 5.0)


def test_a_number_without_a_camera_says_so() -> None:
    with (
        instead_of(RawPicamera2),
        pytest.raises(DeviceMissingError, match="there is no camera 1: check its cable"),
    ):
        open_picamera2(1)


@pytest.mark.skipif(Path("/dev/dma_heap").exists(), reason="there is a DMA heap")
def test_missing_memory_for_frames_says_so() -> None:
    # In a process of its own: picamera2 never lets go of a camera that it failed to open this way.
    script = (
        "from tests.system.real_picamera2.virtual_picamera2 import PlainPicamera2\n"
        "import picamera2\n"
        "picamera2.Picamera2 = PlainPicamera2\n"
        "from veilcam_server.devices import DeviceMissingError\n"
        "from veilcam_server.devices.picamera import open_picamera2\n"
        "try: open_picamera2()\n"
        "except DeviceMissingError as error: print(error)\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", script],
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout == (
        "camera 0 cannot be opened: its memory /dev/dma_heap cannot be opened: "
        "be in the group video\n"
    )


def test_one_without_raw_frames_is_refused_and_let_go() -> None:
    with instead_of(PlainPicamera2):
        for _ in range(2):
            with pytest.raises(SensorError, match="gives no raw frames: use a Raspberry Pi HQ"):
                IMX477(open_picamera2, shape=SHAPE, mode=MODE)


def test_controls_are_those_of_libcamera(bench: Driver) -> None:
    taken = bench.cameras[0].told
    assert set(taken) == {
        "AeEnable",
        "AnalogueGain",
        "AwbEnable",
        "ExposureTime",
        "FrameDurationLimits",
        "NoiseReductionMode",
    }
    off = libcamera.controls.draft.NoiseReductionModeEnum.Off
    assert taken["NoiseReductionMode"] == off.value


def test_a_measurement_is_what_lies_in_the_buffers(bench: Driver) -> None:
    camera, frames = bench.cameras[0], {}

    def look(frame: Any) -> None:
        (buffer,) = frame.request.buffers.values()
        stamp = frame.get_metadata()["SensorTimestamp"]
        frames[stamp / 1e9] = bytes(camera.allocator.maps[buffer])

    camera.pre_callback = look
    exposure = bench.sensor.capture(time.monotonic() + 0.02, 5.0)
    pixels = np.frombuffer(frames[exposure.ended_at], np.uint16).reshape(MODE.rows, MODE.columns)
    black, white = MODE.black_level << 4, MODE.white_level << 4
    mean = area_average(torch.from_numpy(pixels.astype(float)), *SHAPE).numpy()
    np.testing.assert_allclose(exposure.embedding, (mean - black) / (white - black), rtol=1e-5)
    assert np.ptp(exposure.embedding) > 0.05


def test_frames_of_before_are_not_taken(bench: Driver) -> None:
    # Held frames stay where they are, and are older than the fence when they come back.
    camera = bench.cameras[0]
    held = [camera.capture_request(wait=5.0) for _ in range(BUFFERS)]
    fence = time.monotonic()
    giver = threading.Thread(target=lambda: [request.release() for request in held])
    giver.start()
    assert bench.sensor.capture(fence, 5.0).started_at >= fence
    giver.join()
    assert len(bench.cameras) == 1


@pytest.mark.parametrize("kill", [kill_loop, kill_listener])
def test_a_thread_that_dies_is_replaced(bench: Driver, kill: Callable[[Any], None]) -> None:
    camera = bench.cameras[0]
    kill(camera)
    frames = camera.frames
    with pytest.raises(SensorError, match="it gave no frame in time"):
        bench.sensor.capture(0.0, 0.2)
    assert kill is kill_listener or camera.frames == frames
    assert not camera.is_open
    bench.sensor.capture(0.0, 5.0)
    assert len(bench.cameras) == 2


@pytest.mark.parametrize("name", ["ExposureTime", "AnalogueGain"])
def test_a_frame_that_does_not_tell_enough_is_a_failure(bench: Driver, name: str) -> None:
    del bench.cameras[0].told[name]
    frames = bench.cameras[0].frames
    wait_until(lambda: bench.cameras[0].frames > frames + 2 * BUFFERS)
    with pytest.raises(SensorError, match=r"failed \(KeyError\)"):
        bench.sensor.capture(0.0, 5.0)
    bench.sensor.capture(0.0, 5.0)
    assert len(bench.cameras) == 2


def test_closing_ends_a_capture_that_waits(bench: Driver) -> None:
    camera = bench.cameras[0]
    hang(camera)
    caught: list[BaseException] = []

    def capture() -> None:
        try:
            bench.sensor.capture(0.0, 60.0)
        except SensorError as error:
            caught.append(error)

    waiting = threading.Thread(target=capture)
    waiting.start()
    wait_until(lambda: bool(camera._job_list))
    bench.sensor.close()
    waiting.join(30.0)
    assert not waiting.is_alive()
    assert "CancelledError" in str(caught[0])
    assert not camera.is_open


def test_one_that_was_opened_elsewhere_can_be_closed_here(bench: Driver) -> None:
    opener = threading.Thread(target=bench.sensor.capture, args=(0.0, 5.0))
    bench.sensor.close()
    opener.start()
    opener.join()
    bench.sensor.close()
    assert len(bench.cameras) == 2
    assert not any(camera.is_open for camera in bench.cameras)


def test_captures_go_on_through_failures_again_and_again(bench: Driver) -> None:
    failures = [kill_loop, kill_listener, hang, forget] * 5
    measurements = errors = 0
    for number in range(600):
        if number % 30 == 15:
            failures[number // 30](bench.cameras[-1])
        fence = time.monotonic()
        try:
            assert bench.sensor.capture(fence, 0.5).started_at >= fence
            measurements += 1
        except SensorError:
            errors += 1
            assert number % 30 == 15
    assert (measurements, errors) == (580, 20)
    assert len(bench.cameras) == 21
    assert [camera.is_open for camera in bench.cameras] == [False] * 20 + [True]


def test_opening_and_closing_leave_nothing_behind() -> None:
    def held() -> tuple[int, int]:
        gc.collect()
        return len(os.listdir("/proc/self/fd")), threading.active_count()

    with instead_of(RawPicamera2):
        counts = []
        for _ in range(10):
            bench = Driver(open_picamera2, MODE)
            bench.sensor.capture(0.0, 5.0)
            bench.sensor.close()
            del bench
            counts.append(held())
    # The first leaves what libcamera keeps.
    assert set(counts[1:]) == {counts[1]}
