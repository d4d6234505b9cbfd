"""Raw frames of a sensor: modes, layout in memory, times, and averages over their pixels."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from veilcam_server.devices.errors import SensorError
from veilcam_server.devices.picamera import Request

Raw = npt.NDArray[np.uint16]
"""A raw frame, shape (rows, columns)."""


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
        """Count of a saturated pixel."""
        return (1 << self.bit_depth) - 1

    @property
    def readout(self) -> float:
        """Time from the first row's readout to the last one's [s]."""
        return (self.rows - 1) * self.line_time


@dataclass(frozen=True, slots=True)
class RawFormat:
    """Layout of raw pixels in memory, with their counts without light and at most."""

    stride: int
    black: int
    white: int
    order: str
    """Colours of the first two pixels of the first two rows, as ``RGGB``."""

    @classmethod
    def of(cls, given: Mapping[str, Any] | None, mode: SensorMode) -> RawFormat:
        """Read the format from picamera2's description of its raw stream, if there is one.

        Raises:
            SensorError: there is none, or it is packed, compressed or of another size.
        """
        if given is None:
            raise SensorError("the camera gives no raw frames: use a Raspberry Pi HQ camera")
        name, size = str(given["format"]), tuple(given["size"])
        # 12 bits in the low end of 16 (Raspberry Pi 4), or in the high end (5).
        shifts = {str(mode.bit_depth): 0, "16": 16 - mode.bit_depth}
        order, bits = name[1:5], name[5:]
        bayer = name.startswith("S") and sorted(order) == sorted("RGGB")
        if not bayer or bits not in shifts or size != mode.size:
            raise SensorError(
                f"the camera gives raw frames as {name}, {size[0]} x {size[1]}, which cannot be "
                "read: use one that gives them whole and uncompressed"
            )
        shift = shifts[bits]
        black, white = mode.black_level << shift, mode.white_level << shift
        return cls(int(given["stride"]), black, white, order)

    def pixels(self, request: Request, mode: SensorMode) -> Raw:
        """Return a copy of a frame, without what pads its lines.

        Raises:
            SensorError: the frame has another size.
        """
        array = request.make_array("raw")
        if array.shape != (mode.rows, self.stride):
            raise SensorError("the camera gave a raw frame of another size: try again")
        return array.view(np.uint16)[:, : mode.columns]


GAIN = 1.0
"""Analogue, of every frame that is used: the measurement is linear in the light."""


@dataclass(frozen=True, slots=True)
class Frame:
    """Times in nanoseconds."""

    stamp: int
    """When its readout began, monotonic."""
    exposure: int
    gain: float

    @classmethod
    def of(cls, metadata: Mapping[str, Any]) -> Frame:
        """Read the times of a frame from picamera2's metadata.

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

    def unfit(self, fence: int, exposure: float | None, line_time: float) -> str:
        """Say why a frame cannot be used; empty if it can.

        Args:
            fence: before which it must not have begun [ns].
            exposure: exposure that was asked for [s]; None for any.
            line_time: line time of the sensor [s].
        """
        if self.stamp - self.exposure < fence:
            return "exposed before the mask had settled"
        # One line, and what is lost when an exposure is told in whole microseconds.
        if exposure is not None and (abs(self.exposure - exposure * 1e9) > line_time * 1e9 + 1000):
            return "the exposure asked for was not applied"
        if not math.isclose(self.gain, GAIN, rel_tol=1e-3):
            return f"the gain was {self.gain:.3f}, not {GAIN}"
        return ""


class Binning:
    """Averages of raw frames of one shape over equal boxes.

    Args:
        raw: shape (rows, columns) of the frames.
        shape: boxes (rows, columns), or (3, rows, columns) to keep the colours apart.

    Raises:
        ValueError: more boxes than pixels, or than pixels of each colour.
    """

    def __init__(self, raw: tuple[int, int], shape: tuple[int, ...]) -> None:
        self._step = 1 if len(shape) == 2 else 2
        rows, columns = (size // self._step for size in raw)
        self._plane = rows, columns
        self._row_cuts, self._row_shares = _axis(rows, shape[-2])
        self._column_cuts, self._column_shares = _axis(columns, shape[-1])

    def means(self, raw: Raw, order: str = "RGGB") -> npt.NDArray[np.float64]:
        """Return the mean of every box, in colour those of its red, green and blue pixels.

        A pixel stands for the two by two that it is one of.

        Args:
            raw: frame.
            order: colours of the first two pixels of the first two rows.

        Raises:
            ValueError: a frame of another shape.
        """
        if self._step == 1:
            return self._means(raw)
        places = ((0, 0), (0, 1), (1, 0), (1, 1))
        planes = [self._means(raw[row::2, column::2]) for row, column in places]
        found = [[mean for mean, of in zip(planes, order, strict=True) if of == c] for c in "RGB"]
        return np.stack([np.mean(each, axis=0) for each in found])

    def _means(self, raw: Raw) -> npt.NDArray[np.float64]:
        if raw.shape != self._plane:
            raise ValueError(f"a raw frame of shape {raw.shape} is not valid: use {self._plane}")
        # 32 bits hold the sum of 65,537 pixels of 16 bits: more rows than any sensor has.
        strips = np.stack(
            [raw[first:last].sum(0, dtype=np.uint32) for first, last in pairwise(self._row_cuts)]
        )
        sums = np.add.reduceat(strips, self._column_cuts[:-1], axis=1, dtype=np.uint64)
        strips.fill(0)
        means: npt.NDArray[np.float64] = (
            self._row_shares @ sums.astype(np.float64) @ self._column_shares.T
        )
        return means


def _axis(pixels: int, boxes: int) -> tuple[list[int], npt.NDArray[np.float64]]:
    """Return the cuts of an axis, and the share of each piece in the mean of each box."""
    if not 1 <= boxes <= pixels:
        raise ValueError(f"{boxes} boxes are not valid: use 1 to {pixels}, the number of pixels")
    edges = [Fraction(box * pixels, boxes) for box in range(boxes + 1)]
    cuts = sorted({whole for edge in edges for whole in (math.floor(edge), math.ceil(edge))})
    shares = np.zeros((boxes, len(cuts) - 1))
    for box, (low, high) in enumerate(pairwise(edges)):
        for piece, (first, last) in enumerate(pairwise(cuts)):
            inside = min(high, Fraction(last)) - max(low, Fraction(first))
            if inside > 0:
                # Of the piece's sum, each of whose pixels is in the box by the same part.
                shares[box, piece] = float(inside / ((last - first) * (high - low)))
    return cuts, shares
