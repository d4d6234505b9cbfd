"""Health of panel and camera: the watchdog is fed only while both answer.

A bus or a camera that hangs holds a thread for ever, and the event loop, which still answers, would
not notice. So everything that is asked of the device is stamped when it begins and when it ends.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

from veilcam_server.devices.base import Device, Display, Exposure, Levels, Light, Sensor, Shown
from veilcam_server.devices.errors import SensorHungError


class Health:
    """Stamps of what is asked of a device.

    Args:
        longest: time that anything asked of it may take [s].
        clock: monotonic time [s].
    """

    def __init__(self, longest: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._longest, self._clock = longest, clock
        self._begun: dict[object, float] = {}
        self.hung = False
        """Whether the sensor's driver said so last."""
        self._lock = threading.Lock()

    @contextmanager
    def action(self) -> Iterator[None]:
        """Stamp what is asked of the device within."""
        action = object()
        with self._lock:
            self._begun[action] = self._clock()
        try:
            yield
        finally:
            with self._lock:
                del self._begun[action]

    def healthy(self) -> bool:
        """Return whether nothing hangs, or takes longer than it may."""
        now = self._clock()
        with self._lock:
            return not self.hung and all(
                now - begun <= self._longest for begun in self._begun.values()
            )


def stamped(device: Device, health: Health) -> Device:
    """Return ``device``, with everything that is asked of it stamped."""
    return replace(
        device,
        display=_StampedDisplay(device.display, health),
        sensor=_StampedSensor(device.sensor, health),
    )


class _StampedDisplay:
    def __init__(self, display: Display, health: Health) -> None:
        self._display, self._health = display, health
        self.name = display.name

    @property
    def resets(self) -> int:
        return self._display.resets

    def show(self, levels: Levels) -> Shown:
        with self._health.action():
            return self._display.show(levels)

    def blank(self) -> None:
        with self._health.action():
            self._display.blank()

    def close(self) -> None:
        with self._health.action():
            self._display.close()


class _StampedSensor:
    def __init__(self, sensor: Sensor, health: Health) -> None:
        self._sensor, self._health = sensor, health
        self.name, self.full_scale = sensor.name, sensor.full_scale

    def capture(self, not_before: float, timeout: float) -> Exposure:
        with self._stamped():
            return self._sensor.capture(not_before, timeout)

    def light(self, not_before: float, timeout: float) -> Light:
        with self._stamped():
            return self._sensor.light(not_before, timeout)

    @contextmanager
    def _stamped(self) -> Iterator[None]:
        try:
            with self._health.action():
                yield
        except SensorHungError:
            self._health.hung = True
            raise
        self._health.hung = False

    def close(self) -> None:
        with self._health.action():
            self._sensor.close()
