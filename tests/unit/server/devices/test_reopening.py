"""Panel and sensor that go and come back: one attempt at a time, with pauses that grow."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from veilcam_server.devices import (
    DeviceMissingError,
    DisplayError,
    Exposure,
    SensorError,
    Shown,
)
from veilcam_server.devices.base import Light
from veilcam_server.devices.errors import LightError
from veilcam_server.devices.reopening import ReopeningDisplay, ReopeningSensor

from .clock import Clock

LEVELS = np.zeros((2, 2), np.uint8)


class Part:
    """A panel or a sensor; ``fault`` is raised by whatever it is asked."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.absent: Exception | None = None
        self.fault: BaseException | None = None
        self.attempts: list[float] = []
        self.opened = self.closed = self.asked = 0

    def open(self) -> Any:
        self.attempts.append(self.clock.now)
        # What is open is closed before anybody has it again.
        assert self.opened == self.closed
        if self.absent is not None:
            raise self.absent
        self.opened += 1
        return self

    def close(self) -> None:
        self.closed += 1

    def show(self, levels: object) -> Shown:
        self._answer()
        return Shown(self.clock.now)

    def blank(self) -> None:
        self._answer()

    def capture(self, not_before: float, timeout: float) -> Exposure:
        self._answer()
        ones = np.ones((1, 1), np.float32)
        return Exposure(ones, self.clock.now, self.clock.now, light=Light(1.0, 1e-4))

    def light(self, not_before: float, timeout: float) -> Light:
        self._answer()
        return Light(1.0, 1e-4)

    def _answer(self) -> None:
        self.asked += 1
        if self.fault is not None:
            raise self.fault


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def part(clock: Clock) -> Part:
    return Part(clock)


@pytest.fixture
def display(part: Part, clock: Clock) -> ReopeningDisplay:
    return ReopeningDisplay("panel", part.open, clock=clock)


@pytest.fixture
def sensor(part: Part, clock: Clock) -> ReopeningSensor:
    return ReopeningSensor("sensor", 2.0, part.open, clock=clock)


def test_nothing_is_opened_before_it_is_needed_and_then_once(
    part: Part, display: ReopeningDisplay
) -> None:
    assert (display.name, display.resets, part.opened) == ("panel", 0, 0)
    display.show(LEVELS)
    display.blank()
    assert (display.resets, part.opened, part.asked) == (0, 1, 2)
    display.close()
    display.close()
    assert part.closed == 1


def test_sensor_is_what_it_will_be_before_it_is_opened(part: Part, sensor: ReopeningSensor) -> None:
    assert (sensor.name, sensor.full_scale, part.opened) == ("sensor", 2.0, 0)
    assert sensor.capture(0.0, 1.0).embedding == 1
    sensor.close()
    assert (part.opened, part.closed) == (1, 1)


@pytest.mark.parametrize(
    "fault", [DisplayError("no answer"), ZeroDivisionError(), KeyboardInterrupt()]
)
def test_part_that_failed_is_closed_and_opened_again_at_once(
    part: Part, display: ReopeningDisplay, fault: BaseException
) -> None:
    display.show(LEVELS)
    part.fault = fault
    with pytest.raises(type(fault)):
        display.show(LEVELS)
    # What was tested is not proven any more from here on.
    assert (part.closed, display.resets) == (1, 1)
    part.fault = None
    display.show(LEVELS)
    assert (display.resets, part.opened) == (1, 2)


def test_attempts_come_less_and_less_often_while_a_device_is_missing(
    part: Part, sensor: ReopeningSensor, clock: Clock
) -> None:
    part.absent = DeviceMissingError("there is no camera 0")
    for _ in range(4000):
        with pytest.raises(SensorError, match="there is no camera 0") as caught:
            sensor.capture(0.0, 1.0)
        assert caught.value.remedy == "run_doctor"
        clock.sleep(0.1)
    pauses = np.diff(part.attempts)
    np.testing.assert_allclose(pauses[:8], [1, 2, 4, 8, 16, 32, 60, 60], atol=0.2)
    part.absent = None
    clock.sleep(60.0)
    sensor.capture(0.0, 1.0)
    # What was well once is tried again without a pause.
    part.fault = SensorError("no frame")
    with pytest.raises(SensorError):
        sensor.capture(0.0, 1.0)
    part.fault = None
    sensor.capture(0.0, 1.0)


def test_one_that_opens_and_fails_again_and_again_is_paused_for_too(
    part: Part, sensor: ReopeningSensor, clock: Clock
) -> None:
    part.fault = SensorError("no frame in time")
    for _ in range(300):
        with pytest.raises(SensorError, match="no frame in time"):
            sensor.capture(0.0, 1.0)
        clock.sleep(0.1)
    assert len(part.attempts) == part.closed == 5  # after 0, 1, 3, 7 and 15 s


def test_opaque_waits_for_no_pause_and_makes_none_longer(
    part: Part, display: ReopeningDisplay
) -> None:
    part.absent = DeviceMissingError("no bus")
    with pytest.raises(DisplayError):
        display.show(LEVELS)
    for _ in range(5):
        with pytest.raises(DisplayError, match="no bus"):
            display.blank()
    assert len(part.attempts) == 6
    part.absent = None
    display.blank()
    display.show(LEVELS)  # it is open
    part.fault = DisplayError("no answer")
    with pytest.raises(DisplayError):
        display.show(LEVELS)
    part.fault = None
    display.show(LEVELS)


def test_light_is_no_reason_to_open_it_again(part: Part, sensor: ReopeningSensor) -> None:
    part.fault = LightError("saturated")
    for _ in range(3):
        with pytest.raises(LightError):
            sensor.capture(0.0, 1.0)
    assert (part.opened, part.closed) == (1, 0)


def test_one_that_cannot_be_closed_is_opened_again_all_the_same(
    part: Part, display: ReopeningDisplay
) -> None:
    def fail() -> None:
        part.closed += 1
        raise OSError("busy")

    display.show(LEVELS)
    part.close = fail  # type: ignore[method-assign]
    part.fault = DisplayError("no answer")
    with pytest.raises(DisplayError, match="no answer"):
        display.show(LEVELS)
    part.fault = None
    display.show(LEVELS)
    assert part.opened == 2


def test_remedy_of_the_last_failure_is_asked_for_again(
    part: Part, display: ReopeningDisplay
) -> None:
    part.absent = DisplayError("no answer", remedy="check_disk")
    for _ in range(2):
        with pytest.raises(DisplayError, match="no answer") as caught:
            display.show(LEVELS)
        assert caught.value.remedy == "check_disk"
    assert len(part.attempts) == 1
