"""Panel and sensor that are opened when needed and again after a failure, and their health.

What failed is closed before it is opened again, one attempt at a time, with pauses that grow from
one attempt to the next. Between two attempts the reason for the last failure is raised again.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

from veilcam_client.wire.status import Remedy
from veilcam_server.devices.base import (
    Device,
    Display,
    Exposure,
    Levels,
    Light,
    OpenDisplay,
    Sensor,
    Shown,
)
from veilcam_server.devices.errors import (
    DeviceError,
    DisplayError,
    LightError,
    SensorError,
    SensorHungError,
)

FIRST_PAUSE, LONGEST_PAUSE = 1.0, 60.0
"""Between the beginnings of two attempts in a row; each is twice the one before [s]."""

PartT = TypeVar("PartT", bound="_Closable")


class _Closable(Protocol):
    def close(self) -> None: ...


@dataclass(frozen=True, slots=True)
class _Failure:
    """Error as it is remembered: the exception itself would keep what could not be opened."""

    kind: type[DisplayError | SensorError]
    text: str
    remedy: Remedy

    def error(self) -> DisplayError | SensorError:
        return self.kind(self.text, remedy=self.remedy)


class _Part(Generic[PartT]):
    """A panel or a sensor, open or not.

    Args:
        open_part: opens it; raises :class:`DeviceError`.
        kind: kind of the error where it cannot be opened.
        clock: monotonic time [s].
    """

    def __init__(
        self,
        open_part: Callable[[], PartT],
        kind: type[DisplayError | SensorError],
        clock: Callable[[], float],
    ) -> None:
        self._open_part, self._kind, self._clock = open_part, kind, clock
        self._part: PartT | None = None
        self._hung: PartT | None = None
        self._failure: _Failure | None = None
        self._pause, self._not_before = 0.0, -math.inf
        self.closings = 0
        """How often it was let go."""

    @contextmanager
    def open(self, *, at_once: bool = False) -> Iterator[PartT]:
        """Have it open; it is closed if the block raises what is not the light's fault.

        Args:
            at_once: True: no pause is kept.
        """
        part = self._part or self._opened(at_once)
        try:
            yield part
        except LightError:
            raise
        except BaseException as error:
            if isinstance(error, self._kind):
                self._failure = _Failure(type(error), str(error), error.remedy)
            self.close()
            raise
        self._pause, self._not_before = 0.0, -math.inf

    def close(self) -> None:
        """Let go of it, whether that ends well or not."""
        part, self._part = self._part, None
        if part is None:
            return
        self.closings += 1
        try:
            part.close()
        except SensorHungError as error:
            self._hung = part
            self._failure = _Failure(type(error), str(error), error.remedy)
        except Exception:  # noqa: S110 - it is opened anew, come what may
            pass

    def _opened(self, at_once: bool) -> PartT:
        if self._hung is not None:
            self._hung.close()  # or raises: it does not end yet
            self._hung = None
        begun = self._clock()
        if not at_once:
            if begun < self._not_before and self._failure is not None:
                raise self._failure.error()
            self._pause = min(2 * self._pause, LONGEST_PAUSE) or FIRST_PAUSE
            self._not_before = begun + self._pause
        try:
            self._part = self._open_part()
            return self._part
        except (DisplayError, SensorError) as error:
            self._failure = _Failure(type(error), str(error), error.remedy)
        except DeviceError as error:
            self._failure = _Failure(self._kind, str(error), "run_doctor")
        # Not from within: an error's context is kept as long as itself.
        raise self._failure.error()


class ReopeningDisplay:
    """A panel that is set up when it is needed, and anew after a failure.

    Args:
        name: name of the panel.
        open_display: sets it up, opaque; raises :class:`DeviceError`.
        clock: monotonic time [s].
    """

    def __init__(
        self,
        name: str,
        open_display: Callable[[], OpenDisplay],
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name = name
        self._part = _Part(open_display, DisplayError, clock)

    @property
    def resets(self) -> int:
        """Number of times that it was let go: it is set up anew when it is needed next."""
        return self._part.closings

    def show(self, levels: Levels) -> Shown:
        """Write a mask."""
        with self._part.open() as display:
            return display.show(levels)

    def blank(self) -> None:
        """Show opaque; that waits for no pause."""
        with self._part.open(at_once=True) as display:
            display.blank()

    def close(self) -> None:
        """Let go of the bus."""
        self._part.close()


class ReopeningSensor:
    """A sensor that is started when it is needed, and anew after a failure.

    Args:
        name: name of the sensor.
        full_scale: measurement of saturated pixels.
        open_sensor: starts it; raises :class:`DeviceError`.
        clock: monotonic time [s].
    """

    def __init__(
        self,
        name: str,
        full_scale: float,
        open_sensor: Callable[[], Sensor],
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name, self.full_scale = name, full_scale
        self._part = _Part(open_sensor, SensorError, clock)

    def capture(self, not_before: float, timeout: float) -> Exposure:
        """Expose once."""
        with self._part.open() as sensor:
            return sensor.capture(not_before, timeout)

    def light(self, not_before: float, timeout: float) -> Light:
        """Return the light of one frame."""
        with self._part.open() as sensor:
            return sensor.light(not_before, timeout)

    def close(self) -> None:
        """Stop the sensor."""
        self._part.close()


class Health:
    """Stamps of what is asked of a device; the watchdog is fed only while both parts answer.

    A bus or a camera that hangs holds a thread for ever, and the event loop, which still answers,
    would not notice.

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
