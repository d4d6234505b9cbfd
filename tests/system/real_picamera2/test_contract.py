"""What the driver relies on, of the fake picamera2 and the real one alike."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from veilcam_server.devices import SensorError

from .conftest import SHAPE, Driver, Rig

# picamera2 still calls Thread.setDaemon().
pytestmark = pytest.mark.filterwarnings("ignore:setDaemon:DeprecationWarning")
EXPOSURE = 1000
"""[us]"""


@pytest.fixture
def camera(rig: Rig) -> Iterator[Any]:
    camera = rig.open()
    configure(camera, rig)
    yield camera
    camera.cancel_all_and_flush()
    camera.close()


@pytest.fixture
def running(camera: Any) -> Any:
    camera.start()
    return camera


def configure(camera: Any, rig: Rig) -> None:
    camera.configure(
        camera.create_video_configuration(
            main={"size": (64, 64)},
            raw={"format": f"SRGGB{rig.mode.bit_depth}", "size": rig.mode.size},
            sensor={"output_size": rig.mode.size, "bit_depth": rig.mode.bit_depth},
            buffer_count=4,
            queue=False,
        )
    )
    camera.set_controls({"ExposureTime": EXPOSURE, "AnalogueGain": 1.0})


def stamp(camera: Any, flush: int = 0) -> int:
    with camera.captured_request(wait=5.0, flush=flush) as request:
        return int(request.get_metadata()["SensorTimestamp"])


def test_what_was_given_can_be_read_back(camera: Any, rig: Rig) -> None:
    given = camera.camera_configuration()
    assert given["raw"]["size"] == rig.mode.size
    assert given["raw"]["format"] in {"SRGGB12", "SRGGB16"}
    assert given["raw"]["stride"] >= 2 * rig.mode.columns
    assert given["sensor"] == {"output_size": rig.mode.size, "bit_depth": 12}


def test_frames_follow_each_other(running: Any) -> None:
    stamps = [stamp(running) for _ in range(5)]
    assert sorted(set(stamps)) == stamps


def test_a_flushed_frame_began_to_be_exposed_after_that(running: Any) -> None:
    for delay in (0.0, 0.003, 0.02):
        flush = time.monotonic_ns() + round(delay * 1e9)
        assert stamp(running, flush) - 1000 * EXPOSURE >= flush


def test_what_is_known_of_a_frame(running: Any) -> None:
    with running.captured_request(wait=5.0, flush=0) as request:
        metadata = request.get_metadata()
    assert isinstance(metadata["SensorTimestamp"], int)
    assert metadata["ExposureTime"] == EXPOSURE
    assert metadata["AnalogueGain"] == 1.0
    assert metadata["DigitalGain"] == 1.0


def test_an_array_is_a_copy_with_the_padding(running: Any, rig: Rig) -> None:
    with running.captured_request(wait=5.0, flush=0) as request:
        array = request.make_array("raw")
        kept = array.copy()
        array.fill(1)
        again = request.make_array("raw")
    assert array.dtype == np.uint8
    assert array.shape == (rig.mode.rows, running.camera_configuration()["raw"]["stride"])
    assert array.flags.c_contiguous
    np.testing.assert_array_equal(again, kept)


def test_streams_not_asked_for_and_frames_given_back_cannot_be_read(running: Any) -> None:
    with (
        running.captured_request(wait=5.0, flush=0) as request,
        pytest.raises(RuntimeError, match="Stream 'lores' is not defined"),
    ):
        request.make_array("lores")
    with pytest.raises(RuntimeError, match="Stream 'raw' is not defined"):
        request.make_array("raw")


def test_a_frame_is_given_back_when_its_reader_fails(running: Any) -> None:
    for _ in range(10):  # more than there are buffers
        with pytest.raises(KeyError), running.captured_request(wait=5.0, flush=0):
            raise KeyError
    stamp(running)


@pytest.mark.parametrize("started", [False, True])
def test_a_control_that_is_not_there_is_refused(camera: Any, started: bool) -> None:
    if started:
        camera.start()
    with pytest.raises(RuntimeError, match="Control Exposure is not advertised"):
        camera.set_controls({"Exposure": 1000})


def test_controls_may_change_while_it_runs_and_nothing_else(running: Any, rig: Rig) -> None:
    running.set_controls({"ExposureTime": 2 * EXPOSURE})
    told = []
    for _ in range(10):
        with running.captured_request(wait=5.0, flush=0) as request:
            told.append(request.get_metadata()["ExposureTime"])
    assert told[-1] == 2 * EXPOSURE
    with pytest.raises(RuntimeError, match="Camera must be stopped before configuring"):
        configure(running, rig)


def test_it_may_be_started_twice_and_nothing_be_cancelled(running: Any) -> None:
    before = stamp(running)
    running.start()
    between = stamp(running)
    running.cancel_all_and_flush()
    assert stamp(running) > between > before


def test_there_is_no_frame_before_it_is_started(camera: Any) -> None:
    with pytest.raises(TimeoutError), camera.captured_request(wait=0.05, flush=0):
        pass


def test_a_wait_ends_when_it_hangs(running: Any, rig: Rig) -> None:
    rig.hang(running)
    began = time.monotonic()
    with pytest.raises(TimeoutError), running.captured_request(wait=0.2, flush=0):
        pass
    assert time.monotonic() - began >= 0.2


def test_it_is_not_configured_at_first_and_may_be_closed_at_any_time_and_again(rig: Rig) -> None:
    for stage in range(3):
        camera = rig.open()
        assert not camera.camera_configuration()
        if stage > 0:
            configure(camera, rig)
        if stage > 1:
            camera.start()
            stamp(camera)
        camera.close()
        camera.close()


def test_a_closed_one_gives_nothing_and_cannot_be_started(running: Any) -> None:
    stamp(running)
    running.close()
    assert not running.camera_configuration()
    with pytest.raises(TimeoutError), running.captured_request(wait=0.05, flush=0):
        pass
    # picamera2 raises whatever it likes.
    with pytest.raises(Exception):  # noqa: B017, PT011
        running.start()


def test_one_that_was_closed_while_it_hung_can_be_opened_again(running: Any, rig: Rig) -> None:
    before = stamp(running)
    rig.hang(running)
    with pytest.raises(TimeoutError), running.captured_request(wait=0.05, flush=0):
        pass
    running.cancel_all_and_flush()
    running.close()
    another = rig.open()
    configure(another, rig)
    another.start()
    assert stamp(another) > before
    another.close()


def test_the_driver_reads_frames_after_the_fence(rig: Rig) -> None:
    opened = Driver(rig.open, rig.mode)
    last = 0.0
    for _ in range(5):
        fence = time.monotonic() + 0.003
        exposure = opened.sensor.capture(fence, 5.0)
        assert exposure.embedding.shape == SHAPE
        assert fence <= exposure.started_at < exposure.ended_at
        assert exposure.ended_at > last
        assert exposure.integration == pytest.approx(EXPOSURE / 1e6)
        last = exposure.ended_at
    opened.sensor.close()
    assert len(opened.cameras) == 1


def test_the_driver_opens_a_camera_again_that_hangs_again_and_again(rig: Rig) -> None:
    opened = Driver(rig.open, rig.mode)
    opened.sensor.capture(0.0, 5.0)
    for times in range(1, 6):
        rig.hang(opened.cameras[-1])
        with pytest.raises(SensorError, match="it gave no frame in time"):
            opened.sensor.capture(0.0, 0.2)
        if times == 1:  # the next capture opens it by itself
            opened.sensor.capture(0.0, 5.0)
        with opened.sensor._part.open():
            pass
        assert len(opened.cameras) == 1 + times
    opened.sensor.capture(0.0, 5.0)
    assert len(opened.cameras) == 6
    opened.sensor.close()
