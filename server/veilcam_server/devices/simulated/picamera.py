"""A camera in the shape of picamera2's, with raw frames made of whatever light it is given.

It has what makes a real one hard to use: frames at its own pace, a frame from before in the queue,
controls that come into force some frames late, padded lines. It also fails on demand. What it has
in common with the real picamera2 is held by ``tests/system/real_picamera2``, which both pass.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from veilcam_client.wire.simulation import SensorFaults
from veilcam_server.devices.driver import RawLight
from veilcam_server.devices.raw import SensorMode

_NANO = 1_000_000_000
_ALIGNED = 64
"""Bytes to a multiple of which lines are padded."""
_ADAPTING = {
    "AeEnable": True,
    "AnalogueGain": 1.0,
    "AwbEnable": True,
    "ExposureTime": 10_000,
    "FrameDurationLimits": (33_333, 33_333),
    "NoiseReductionMode": 1,
}
"""Controls there are, and what they come to while nobody sets them."""


@dataclass(slots=True)
class CameraFaults:
    """Faults to come. Counts go down by one for every frame asked for."""

    gone: bool = False
    """It cannot be opened, and no frame comes."""
    silent: bool = False
    """No frame comes."""
    hangs: int = 0
    """Frames that never come."""
    stale: int = 0
    """Frames from the queue that are given out although they began too early."""
    stuck: bool = False
    """Every frame is the first one again."""
    deaf: bool = False
    """Controls have no effect."""
    gain: float = 1.0
    """What the gain is in truth."""
    format: str | None = None
    """Of raw frames, in the place of what was asked."""
    opening: Exception | None = None
    """Raised when the camera is opened."""

    def switch(self, faults: SensorFaults) -> None:
        """Let that be wrong, from now on, what is asked for."""
        self.gone, self.silent, self.stuck = faults.gone, faults.silent, faults.stuck


class FakePicamera2:
    """A ``Picamera``. Frames come at the mode's pace, or, if that is 0, when they are asked for.

    Args:
        light: makes the frames.
        mode: the only one it has.
        delay: frames until controls are in force.
        faults: shared with whoever wants to see it fail.
        clock: monotonic time [s].
        sleep: waits so many seconds.
    """

    def __init__(
        self,
        light: RawLight,
        *,
        mode: SensorMode,
        delay: int = 2,
        faults: CameraFaults | None = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._light, self._mode, self._delay = light, mode, delay
        self.faults = faults or CameraFaults()
        self._clock, self._sleep = clock, sleep
        if self.faults.gone:
            raise RuntimeError("No camera number 0 found")
        if self.faults.opening is not None:
            raise self.faults.opening
        self._configuration: dict[str, Any] = {}
        self._controls: list[tuple[int, dict[str, Any]]] = [(-1, dict(_ADAPTING))]
        self._number, self._started_at = -1, math.inf
        self._before: FakeRequest | None = None
        self.frames = 0
        self.started = self.closed = False

    def create_video_configuration(
        self,
        *,
        main: dict[str, Any],
        raw: dict[str, Any],
        sensor: dict[str, Any],
        buffer_count: int,
        queue: bool,
    ) -> dict[str, Any]:
        """Return what was asked."""
        return {
            "main": main,
            "raw": raw,
            "sensor": sensor,
            "buffer_count": buffer_count,
            "queue": queue,
        }

    def configure(self, camera_config: dict[str, Any]) -> None:
        """Take what was asked as far as there is such a mode."""
        if self.started:
            raise RuntimeError("Camera must be stopped before configuring")
        line = 2 * self._mode.columns
        raw = {
            "format": self.faults.format or camera_config["raw"]["format"],
            "size": self._mode.size,
            "stride": -(-line // _ALIGNED) * _ALIGNED,
        }
        sensor = {"output_size": self._mode.size, "bit_depth": self._mode.bit_depth}
        self._configuration = {**camera_config, "raw": raw, "sensor": sensor}
        self._controls = [(-1, dict(_ADAPTING))]

    def camera_configuration(self) -> Mapping[str, Any]:
        """Return what was given."""
        return self._configuration

    def set_controls(self, controls: dict[str, Any]) -> None:
        """Change controls, some frames from now; from the first one on if it is not started."""
        for name in controls:
            if name not in _ADAPTING:
                raise RuntimeError(f"Control {name} is not advertised by libcamera")
        since = self._running() + self._delay if self.started else -1
        if not self.faults.deaf:
            self._controls.append((since, {**self._controls[-1][1], **controls}))

    def start(self) -> None:
        """Begin to take frames."""
        if not self._configuration:
            raise RuntimeError("Camera has not been configured")
        if not self.started:
            self.started, self._started_at, self._number = True, self._clock(), -1

    def close(self) -> None:
        """Stop, and let go."""
        self.started, self.closed, self._configuration = False, True, {}

    def cancel_all_and_flush(self) -> None:
        """Nothing is pending: every request was waited for."""

    @contextmanager
    def captured_request(self, *, wait: float, flush: int) -> Iterator[FakeRequest]:
        """Wait for a frame that began at ``flush`` [ns] or later."""
        faults, until = self.faults, self._clock() + wait
        if faults.gone or faults.silent or faults.hangs > 0 or not self.started:
            faults.hangs = max(0, faults.hangs - self.started)
            self._sleep_until(until)
            raise TimeoutError
        if self._before is not None and faults.stuck:
            yield self._before
            return
        if faults.stale > 0:
            faults.stale -= 1
            flush = 0
        number, begin, end = self._next(flush)
        done = end + round(self._mode.readout * _NANO)
        if done > until * _NANO:
            self._sleep_until(until)
            raise TimeoutError
        self._sleep_until(done / _NANO)
        self._number = number
        self.frames += 1
        self._before = self._take(begin, end, self._in_force(number))
        try:
            yield self._before
        finally:
            self._before.release()

    def _next(self, flush: int) -> tuple[int, int, int]:
        """Return the next frame's number, with its first row's begin and end [ns]."""
        now = math.ceil(self._clock() * _NANO)
        pace = round(self._mode.frame_duration * _NANO)
        number = self._number + 1
        if pace == 0:
            begin = max(now, flush)
            return number, begin, begin + self._exposure(number)
        number = max(number, self._running())
        while True:
            end = round(self._started_at * _NANO) + (number + 1) * pace
            if end - self._exposure(number) >= flush:
                return number, end - self._exposure(number), end
            number += 1

    def _running(self) -> int:
        """Return the number of the frame that is being exposed."""
        pace = self._mode.frame_duration
        if not (self.started and pace > 0):
            return self._number + 1
        return max(self._number + 1, math.floor((self._clock() - self._started_at) / pace))

    def _in_force(self, number: int) -> dict[str, Any]:
        return next(controls for since, controls in reversed(self._controls) if since <= number)

    def _exposure(self, number: int) -> int:
        """Return an exposure in whole lines that do not exceed it, in whole microseconds [ns]."""
        asked, line = int(self._in_force(number)["ExposureTime"]), self._mode.line_time * 1e6
        # As much more than asked as makes 100 lines of 0.1 ms out of 10 ms.
        return 1000 * (int(math.floor(asked / line + 1e-6) * line) if line > 0 else asked)

    def _take(self, begin: int, end: int, controls: Mapping[str, Any]) -> FakeRequest:
        mode = self._mode
        pixels = self._light(begin / _NANO, end / _NANO)
        if mode.readout > 0:
            # Rows integrate one after the other; between the first and the last it goes evenly.
            last = self._light(begin / _NANO + mode.readout, end / _NANO + mode.readout)
            if not np.array_equal(pixels, last):
                down = np.linspace(0.0, 1.0, mode.rows)[:, None]
                pixels = np.rint(pixels + (last.astype(float) - pixels) * down).astype(np.uint16)
        stride = self._configuration["raw"]["stride"]
        buffer = np.full((mode.rows, stride), 0xFF, np.uint8)
        shift = 16 - mode.bit_depth if self._configuration["raw"]["format"].endswith("16") else 0
        buffer.view(np.uint16)[:, : mode.columns] = pixels << shift
        return FakeRequest(
            buffer,
            {
                "SensorTimestamp": end,
                "ExposureTime": round((end - begin) / 1000),
                "AnalogueGain": self.faults.gain * controls["AnalogueGain"],
                # Of images alone: makes up for an exposure of whole lines.
                "DigitalGain": max(1.0, 1000 * controls["ExposureTime"] / max(end - begin, 1)),
                "FrameDuration": controls["FrameDurationLimits"][0],
            },
        )

    def _sleep_until(self, until: float) -> None:
        while (left := until - self._clock()) > 0:
            self._sleep(left)


class FakeRequest:
    """A frame."""

    def __init__(self, buffer: npt.NDArray[np.uint8], metadata: dict[str, Any]) -> None:
        self._buffer: npt.NDArray[np.uint8] | None = buffer
        self._metadata = metadata

    def make_array(self, name: str) -> npt.NDArray[np.uint8]:
        """Return a copy of the buffer."""
        if name != "raw" or self._buffer is None:
            raise RuntimeError(f"Stream {name!r} is not defined")
        return self._buffer.copy()

    def get_metadata(self) -> dict[str, Any]:
        """Return what is known of the frame."""
        return dict(self._metadata)

    def release(self) -> None:
        """Give the buffer back."""
        if self._buffer is not None:
            self._buffer.fill(0)
        self._buffer = None
