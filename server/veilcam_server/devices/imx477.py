"""The IMX477 through picamera2: one measurement for one exposure that is known to the microsecond.

Row r integrates from ``S - E + r L`` to ``S + r L``: S the start of readout that the camera reports
(``SensorTimestamp``), E the exposure, L the time of a line. Everything here concerns the raw plane:
whatever picamera2 makes of it goes through gamma and sharpening.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from veilcam_client.numbers import erasable
from veilcam_client.wire.simulation import SensorFaults
from veilcam_server.devices.base import Exposure, Light, Measurement, Sensor
from veilcam_server.devices.driver import RawLight, SensorDriver
from veilcam_server.devices.errors import (
    Refused,
    SaturatedError,
    SensorError,
    SensorHungError,
    in_one_line,
    without_text,
)
from veilcam_server.devices.picamera import Picamera, open_picamera2, opened
from veilcam_server.devices.raw import GAIN, Binning, Frame, Raw, RawFormat, SensorMode
from veilcam_server.settings import Settings

HALF = SensorMode(1520, 2028, line_time=15.17e-6, frame_duration=0.025)
"""Two by two pixels binned on the sensor, 40 frames a second."""

_NANO, _MICRO = 1_000_000_000, 1_000_000
_SATURATED = 1e-3
"""Share of saturated pixels from which on a measurement is no longer linear in the light."""
_NOISE = 1e-4
"""Error of a frame's mean light, over saturation: half a step of 12 bits of its black level."""
_DIM, _MIDDLE = 0.2, 0.5
"""A brightest value below the one asks for an exposure that brings it to the other."""
_CLOSING = 5.0
"""Longest time for a camera to let go [s]."""


@dataclass(frozen=True, slots=True)
class ExposureRange:
    """Exposure to begin with, and how many times shorter or longer it may become."""

    start: float = 0.01
    """[s]"""
    factor: float = 1.0
    """1 for an exposure that is fixed."""

    def bounded(self, exposure: float) -> float:
        """Return the nearest exposure in range [s]."""
        return min(max(exposure, self.start / self.factor), self.start * self.factor)


@dataclass(frozen=True, slots=True)
class _Binned:
    """A frame in shares of saturation."""

    embedding: npt.NDArray[np.float64]
    saturated: bool


class IMX477:
    """A camera whose raw frames are binned and dropped. Constructing one opens it.

    Args:
        open_camera: opens the camera.
        shape: shape of a measurement, (rows, columns) or (3, rows, columns).
        fill: side of the box that a value averages, as a share of its embedding pixel's.
        mode: pinned; another one is refused.
        exposures: fixed or bounded; the gain is always 1.
        full_scale: measurement of saturated pixels at the exposure to begin with.
        clock: monotonic time [s].

    Raises:
        SensorError: the camera gives another mode or format, or boxes are too small for its pixels.
        DeviceMissingError: it is not there.
    """

    name = "IMX477"

    def __init__(
        self,
        open_camera: Callable[[], Picamera],
        *,
        shape: tuple[int, ...],
        fill: float = 1.0,
        mode: SensorMode = HALF,
        exposures: ExposureRange = ExposureRange(),
        full_scale: float = 1.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._mode, self._exposures, self._clock = mode, exposures, clock
        self.full_scale = full_scale
        """Measurement of saturated pixels at the exposure to begin with."""
        try:
            self._binning = Binning((mode.rows, mode.columns), shape, fill)
        except ValueError as error:
            raise SensorError(f"the sensor is too coarse for this bundle: {error}") from None
        self._asked = exposures.start
        self._last_stamp, self._unfit = -1, ""
        self._format: RawFormat
        self._closing: threading.Thread | None = None
        self._camera = open_camera()
        self._start()

    def capture(self, not_before: float, timeout: float) -> Exposure:
        """Wait for a frame that was exposed wholly after ``not_before``, and bin it.

        The exposure may change from one measurement to the next if it may at all; the measurement
        does not, as it is given for the exposure to begin with.
        """
        deadline = max(not_before, self._clock()) + timeout
        with Refused(self._failed):
            return self._capture(self._camera, not_before, deadline)

    def light(self, not_before: float, timeout: float) -> Light:
        """Return the light of one frame of any exposure, which no later exposure follows."""
        deadline = max(not_before, self._clock()) + timeout
        with Refused(self._failed):
            self._unfit = ""
            frame, binned = self._frame(self._camera, not_before, deadline, asked=None)
            return self._light(frame, binned)

    def close(self) -> None:
        """Stop the camera."""
        if self._closing is None:
            self._closing = threading.Thread(target=self._close, daemon=True)
            self._closing.start()
            self._closing.join(_CLOSING)
        if self._closing.is_alive():
            raise SensorHungError("the camera hangs while it is closed: start the daemon again")

    def _failed(self, error: Exception) -> SensorError:
        if isinstance(error, TimeoutError):
            unfit = self._unfit
            reason = f"no frame was fit for use: {unfit}" if unfit else "it gave no frame"
            return SensorError(f"the camera is opened again, as {reason} in time: try again")
        # Its text may tell of the frame.
        return SensorError(f"the camera failed ({without_text(error)}): it is opened again")

    def _capture(self, camera: Picamera, not_before: float, deadline: float) -> Exposure:
        self._unfit = ""
        while True:
            frame, binned = self._frame(camera, not_before, deadline, self._asked)
            if binned.saturated:
                self._unfit = self._shorten(camera)
                continue
            brightest = float(np.max(binned.embedding))
            exposure = self._exposure(frame, binned)
            self._follow(camera, brightest)
            return exposure

    def _frame(
        self, camera: Picamera, not_before: float, deadline: float, asked: float | None
    ) -> tuple[Frame, _Binned]:
        """Return the next frame that is fit for use, at an exposure or at any.

        Args:
            camera: camera that takes it.
            not_before: monotonic time before which it does not begin [s].
            deadline: monotonic time [s].
            asked: exposure that was asked for [s]; None for any.
        """
        # A nanosecond more than asked: no rounding of the float may put a frame before the fence.
        fence = math.ceil(not_before * _NANO) + 1 if math.isfinite(not_before) else 0
        while True:
            wait = deadline - self._clock()
            if self._unfit and wait <= 0:
                raise TimeoutError
            # A wait of 0 would not wait at all, and give no frame either.
            with camera.captured_request(wait=max(wait, 1e-3), flush=fence) as request:
                frame = Frame.of(request.get_metadata())
                if frame.stamp <= self._last_stamp:
                    raise SensorError("the camera gave the same frame again")
                self._last_stamp = frame.stamp
                self._unfit = frame.unfit(fence, asked, self._mode.line_time)
                if self._unfit:
                    continue
                raw = self._format.pixels(request, self._mode)
            # From here on the camera has its buffer back, and `raw` is the only copy.
            try:
                return frame, self._binned(raw)
            finally:
                raw.fill(0)

    def _binned(self, raw: Raw) -> _Binned:
        black, white = self._format.black, self._format.white
        embedding = self._binning.means(raw, self._format.order)
        embedding -= black
        embedding /= white - black
        return _Binned(embedding, float((raw >= white).mean()) > _SATURATED)

    def _exposure(self, frame: Frame, binned: _Binned) -> Exposure:
        light, measured = self._light(frame, binned), binned.embedding
        measured *= self.full_scale * self._scale(frame)
        embedding: Measurement = erasable(measured)
        return Exposure(
            embedding,
            started_at=(frame.stamp - frame.exposure) / _NANO,
            ended_at=frame.stamp / _NANO + self._mode.readout,
            light=light,
            integration=frame.exposure / _NANO,
        )

    def _light(self, frame: Frame, binned: _Binned) -> Light:
        scale = self._scale(frame)
        return Light(scale * float(binned.embedding.mean()), scale * _NOISE, binned.saturated)

    def _scale(self, frame: Frame) -> float:
        """Exposure to begin with, over that of a frame."""
        return self._exposures.start * _NANO / frame.exposure if frame.exposure > 0 else 1.0

    def _shorten(self, camera: Picamera) -> str:
        shorter = self._exposures.bounded(self._asked / 4)
        if shorter >= self._asked:
            raise SaturatedError(
                f"the sensor is saturated at {self._asked * 1000:g} ms: "
                "use less light or a shorter exposure"
            )
        self._ask(camera, shorter)
        return "the sensor was saturated"

    def _follow(self, camera: Picamera, brightest: float) -> None:
        """After a dim measurement, expose the next one longer."""
        if 0 < brightest < _DIM:
            longer = self._exposures.bounded(self._asked * _MIDDLE / brightest)
            if longer > self._asked:
                self._ask(camera, longer)

    def _ask(self, camera: Picamera, exposure: float) -> None:
        self._asked = exposure
        camera.set_controls(self._controls())

    def _controls(self) -> dict[str, Any]:
        exposure = round(self._asked * _MICRO)
        frame = max(round(self._mode.frame_duration * _MICRO), exposure + 1000)
        return {
            "AeEnable": False,
            "AwbEnable": False,
            "NoiseReductionMode": 0,
            "AnalogueGain": GAIN,
            "ExposureTime": exposure,
            "FrameDurationLimits": (frame, frame),
        }

    def _start(self) -> None:
        """Pin the mode, read back what was given, and start; or let go of the camera."""
        try:
            with Refused(_not_set_up):
                self._configure()
        except BaseException:
            with suppress(SensorHungError):
                self.close()
            # Whoever keeps the error has this object by it, and is not to have the camera.
            del self._camera
            raise

    def _configure(self) -> None:
        sensor = {"output_size": self._mode.size, "bit_depth": self._mode.bit_depth}
        self._camera.configure(
            self._camera.create_video_configuration(
                # picamera2 insists on a processed stream; nobody looks at it.
                main={"size": (64, 64)},
                raw={"format": f"SRGGB{self._mode.bit_depth}", "size": self._mode.size},
                sensor=sensor,
                buffer_count=4,
                queue=False,
            )
        )
        given = self._camera.camera_configuration()
        self._format = RawFormat.of(given["raw"], self._mode)
        if {key: given["sensor"][key] for key in sensor} != sensor:
            raise SensorError(
                f"the camera did not take the mode {self._mode.columns} x {self._mode.rows}, "
                f"{self._mode.bit_depth} bit: use a Raspberry Pi HQ camera"
            )
        # Not before it is known to be such a camera: others do not know all of these. Until it
        # is started they are in force from the first frame on.
        self._camera.set_controls(self._controls())
        self._camera.start()

    def _close(self) -> None:
        # Not stop(): that waits for picamera2's own thread, for ever if it has died. close() ends
        # that thread first, and then stops the camera by itself.
        for step in (self._camera.cancel_all_and_flush, self._camera.close):
            with suppress(Exception):
                step()


def _not_set_up(error: Exception) -> SensorError:
    return SensorError(
        f"the camera cannot be set up ({in_one_line(error)}): use a Raspberry Pi HQ camera, and "
        "see rpicam-hello --list-cameras"
    )


def _open(settings: Settings, shape: tuple[int, ...], fill: float) -> IMX477:
    return IMX477(
        partial(open_picamera2, settings.camera_number),
        shape=shape,
        fill=fill,
        exposures=ExposureRange(settings.exposure, settings.exposure_factor),
    )


def _emulate(
    light: RawLight,
    mode: SensorMode,
    *,
    shape: tuple[int, ...],
    fill: float = 1.0,
    exposure: float,
    full_scale: float,
    clock: Callable[[], float],
    sleep: Callable[[float], None],
) -> tuple[Callable[[], Sensor], Callable[[SensorFaults], None]]:
    # Imported late: no real sensor needs it.
    from veilcam_server.devices.simulated.picamera import CameraFaults, FakePicamera2  # noqa: PLC0415

    faults = CameraFaults()
    make = partial(FakePicamera2, light, mode=mode, faults=faults, clock=clock, sleep=sleep)
    start = partial(
        IMX477,
        lambda: opened(make, 0),
        shape=shape,
        fill=fill,
        mode=mode,
        exposures=ExposureRange(exposure),
        full_scale=full_scale,
        clock=clock,
    )
    return start, faults.switch


DRIVER: Final = SensorDriver(
    name=IMX477.name,
    model="imx477",
    product="a Raspberry Pi HQ camera (IMX477)",
    open=_open,
    emulate=_emulate,
    packages=("libcamera", "picamera2"),
)
