"""How a sensor is read out, and how its raw frames lie in memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from veilcam_server.devices.binning import Raw
from veilcam_server.devices.errors import SensorError
from veilcam_server.devices.picamera import Request


@dataclass(frozen=True, slots=True)
class SensorMode:
    """A way to read out the whole sensor. Times in seconds."""

    rows: int
    columns: int
    line_time: float
    frame_duration: float
    bit_depth: int = 12
    black_level: int = 256

    @property
    def size(self) -> tuple[int, int]:
        """As picamera2 has it: columns, rows."""
        return self.columns, self.rows

    @property
    def white_level(self) -> int:
        """Of a saturated pixel."""
        return (1 << self.bit_depth) - 1

    @property
    def readout(self) -> float:
        """From the first row's readout to the last one's [s]."""
        return (self.rows - 1) * self.line_time


HALF = SensorMode(1520, 2028, line_time=15.17e-6, frame_duration=0.025)
"""Two by two pixels binned on the sensor, 40 frames a second."""


@dataclass(frozen=True, slots=True)
class RawFormat:
    """How raw pixels lie in memory, and what they count without light and at most."""

    stride: int
    black: int
    white: int

    @classmethod
    def of(cls, given: Mapping[str, Any] | None, mode: SensorMode) -> RawFormat:
        """From what picamera2 says of its raw stream, if there is one.

        Raises:
            SensorError: there is none, or it is packed, compressed or of another size.
        """
        if given is None:
            raise SensorError("the camera gives no raw frames: use a Raspberry Pi HQ camera")
        name, size = str(given["format"]), tuple(given["size"])
        # 12 bits in the low end of 16 (Raspberry Pi 4), or in the high end (5).
        shifts = {str(mode.bit_depth): 0, "16": 16 - mode.bit_depth}
        bits = name[5:]
        if not name.startswith("S") or bits not in shifts or size != mode.size:
            raise SensorError(
                f"the camera gives raw frames as {name}, {size[0]} x {size[1]}, which cannot be "
                "read: use one that gives them whole and uncompressed"
            )
        shift = shifts[bits]
        return cls(int(given["stride"]), mode.black_level << shift, mode.white_level << shift)

    def pixels(self, request: Request, mode: SensorMode) -> Raw:
        """Return a copy of a frame, without what pads its lines.

        Raises:
            SensorError: the frame has another size.
        """
        array = request.make_array("raw")
        if array.shape != (mode.rows, self.stride):
            raise SensorError("the camera gave a raw frame of another size: try again")
        return array.view(np.uint16)[:, : mode.columns]
