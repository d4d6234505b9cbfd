"""What a camera tells of a frame, and whether the frame can be used."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

GAIN = 1.0
"""Analogue, of every frame that is used: the reading is linear in the light."""


@dataclass(frozen=True, slots=True)
class Frame:
    """Times in nanoseconds."""

    stamp: int
    """When its readout began, monotonic."""
    exposure: int
    gain: float

    @classmethod
    def of(cls, metadata: Mapping[str, Any]) -> Frame:
        """From picamera2's metadata.

        Raises:
            KeyError: they do not tell enough.
        """
        return cls(
            int(metadata["SensorTimestamp"]),
            round(float(metadata["ExposureTime"]) * 1000),
            # Not DigitalGain: the image processor makes up with it for an exposure of whole lines,
            # after the raw plane was written (libcamera, src/ipa/rpi).
            float(metadata["AnalogueGain"]),
        )

    def unfit(self, fence: int, exposure: float, line_time: float) -> str:
        """Why it cannot be used; nothing if it can.

        Args:
            fence: before which it must not have begun [ns].
            exposure: that was asked for [s].
            line_time: of the sensor [s].
        """
        if self.stamp - self.exposure < fence:
            return "exposed before the mask had settled"
        # One line, and what is lost when an exposure is told in whole microseconds.
        if abs(self.exposure - exposure * 1e9) > line_time * 1e9 + 1000:
            return "the exposure asked for was not applied"
        if not math.isclose(self.gain, GAIN, rel_tol=1e-3):
            return f"the gain was {self.gain:.3f}, not {GAIN}"
        return ""
