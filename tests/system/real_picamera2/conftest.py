"""Opens either camera: the fake one, and the real picamera2 where there is libcamera."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest

from veilcam_server.devices.imx477 import IMX477, ExposureRange
from veilcam_server.devices.picamera import open_picamera2
from veilcam_server.devices.raw import SensorMode
from veilcam_server.devices.reopening import ReopeningSensor
from veilcam_server.devices.simulated.picamera import CameraFaults, FakePicamera2

SHAPE = (4, 5)
REAL = find_spec("libcamera") is not None
# `make test` has no libcamera; `make test-libcamera` has.
collect_ignore = [] if REAL else ["test_picamera2.py", "virtual_picamera2.py"]
os.environ.setdefault("LIBCAMERA_LOG_LEVELS", "*:FATAL")


@dataclass
class Rig:
    mode: SensorMode
    open: Callable[[], Any]
    hang: Callable[[Any], None]


def fake_rig(stack: ExitStack) -> Rig:
    mode, faults = SensorMode(96, 96, line_time=0.0, frame_duration=0.002), CameraFaults()

    def open_camera() -> FakePicamera2:
        return FakePicamera2(lambda *_: np.full((96, 96), 300, np.uint16), mode=mode, faults=faults)

    def hang(_: object) -> None:
        faults.hangs = 1

    return Rig(mode, open_camera, hang)


def real_rig(stack: ExitStack) -> Rig:
    from .virtual_picamera2 import BUFFERS, MODE, RawPicamera2, instead_of

    stack.enter_context(instead_of(RawPicamera2))

    def open_camera() -> Any:
        camera = open_picamera2()
        stack.callback(camera.close)
        return camera

    def hang(camera: Any) -> None:
        # A frame that is not given back does not come again.
        camera.held = [camera.capture_request(wait=5.0) for _ in range(BUFFERS)]

    return Rig(MODE, open_camera, hang)


@pytest.fixture(params=[fake_rig, real_rig] if REAL else [fake_rig], ids=lambda rig: rig.__name__)
def rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    with ExitStack() as stack:
        yield request.param(stack)


class Driver:
    def __init__(self, opens: Callable[[], Any], mode: SensorMode) -> None:
        self.cameras: list[Any] = []

        def open_camera() -> Any:
            self.cameras.append(opens())
            return self.cameras[-1]

        given: dict[str, Any] = {"shape": SHAPE, "mode": mode, "exposures": ExposureRange(0.001)}
        self.sensor = ReopeningSensor("IMX477", 1.0, lambda: IMX477(open_camera, **given))
        with self.sensor._part.open():
            pass


def wait_until(condition: Callable[[], bool], seconds: float = 10.0) -> None:
    until = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > until:
            raise TimeoutError
        time.sleep(0.01)
