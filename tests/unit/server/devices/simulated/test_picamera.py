"""The fake picamera2: faults that are switched on and off."""

from __future__ import annotations

import numpy as np
import pytest
from tests.unit.server.devices.clock import Clock

from veilcam_client.wire.simulation import SensorFaults
from veilcam_server.devices import DeviceMissingError, Sensor, SensorError
from veilcam_server.devices.imx477 import DRIVER
from veilcam_server.devices.raw import SensorMode

MODE = SensorMode(48, 64, line_time=0.0, frame_duration=0.0)


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_faults_are_switched_on_and_off(clock: Clock) -> None:
    assert DRIVER.emulate is not None
    start, set_faults = DRIVER.emulate(
        lambda *_: np.full((48, 64), 1000, np.uint16),
        MODE,
        shape=(2, 2),
        exposure=0.0,
        full_scale=1.0,
        clock=clock,
        sleep=clock.sleep,
    )

    def capture(sensor: Sensor) -> None:
        clock.sleep(1.0)
        sensor.capture(clock.now, 0.5)

    sensor = start()
    capture(sensor)
    for faults, error in (
        (SensorFaults(gone=True), SensorError),
        (SensorFaults(silent=True), SensorError),
        (SensorFaults(stuck=True), SensorError),
    ):
        set_faults(faults)
        with pytest.raises(error):
            capture(sensor)
        set_faults(SensorFaults())
        sensor.close()
        sensor = start()
        capture(sensor)
    set_faults(SensorFaults(gone=True))
    with pytest.raises(DeviceMissingError, match="there is no camera 0: check its cable"):
        start()
