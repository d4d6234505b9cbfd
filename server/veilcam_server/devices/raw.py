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

from veilcam_client.numbers import erasable
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
    """Averages of raw frames of one shape over equal boxes, each in the middle of its own part.

    A raw pixel on a box's edge counts by its covered area. Full boxes of a gray measurement average
    all their pixels alike. Smaller ones average each Bayer colour by itself and then the four, as a
    box of few pixels holds more of one colour than of another: a tenth too much of six by six.

    Args:
        raw: shape (rows, columns) of the frames.
        shape: boxes (rows, columns), or (3, rows, columns) to keep the colours apart.
        fill: side of a box, as a share of the part's.

    Raises:
        ValueError: a box of less than a pixel, or than a pixel of each colour.
    """

    def __init__(self, raw: tuple[int, int], shape: tuple[int, ...], fill: float = 1.0) -> None:
        self._raw, self._colour = raw, len(shape) == 3
        self._step = 2 if self._colour or fill < 1 else 1
        self._rows, self._columns = (
            [_axis(pixels, boxes, fill, first, self._step) for first in range(self._step)]
            for pixels, boxes in zip(raw, shape[-2:], strict=True)
        )

    def means(self, raw: Raw, order: str = "RGGB") -> npt.NDArray[np.float64]:
        """Return the mean of every box, in colour those of its red, green and blue pixels.

        Args:
            raw: frame.
            order: colours of the first two pixels of the first two rows.

        Raises:
            ValueError: a frame of another shape.
        """
        if raw.shape != self._raw:
            raise ValueError(f"a raw frame of shape {raw.shape} is not valid: use {self._raw}")
        step = self._step
        planes = [
            _means(raw[first::step, second::step], rows, columns)
            for first, rows in enumerate(self._rows)
            for second, columns in enumerate(self._columns)
        ]
        if not self._colour:
            return _mean(planes)
        found = [[mean for mean, of in zip(planes, order, strict=True) if of == c] for c in "RGB"]
        return np.stack([_mean(each) for each in found])


def _mean(planes: list[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
    """Return the mean of several planes, which are overwritten."""
    mean = erasable(planes[0], np.float64)
    for each in planes[1:]:
        mean += each
    mean /= len(planes)
    for each in planes:
        each.fill(0)
    return mean


def _means(raw: Raw, rows: _Boxes, columns: _Boxes) -> npt.NDArray[np.float64]:
    # 32 bits hold the sum of 65,537 pixels of 16 bits: more rows than any sensor has.
    strips = np.stack(
        [raw[first:last].sum(0, dtype=np.uint32) for first, last in pairwise(rows.cuts)]
    )
    inside = strips[:, : columns.cuts[-1]]
    sums = np.add.reduceat(inside, columns.cuts[:-1], axis=1, dtype=np.uint64)
    strips.fill(0)
    means: npt.NDArray[np.float64] = rows.shares @ sums.astype(np.float64) @ columns.shares.T
    return means


@dataclass(frozen=True, slots=True)
class _Boxes:
    """Boxes along one axis of a plane of pixels."""

    cuts: list[int]
    """Ends of the pieces whose pixels are in the same boxes by the same part."""
    shares: npt.NDArray[np.float64]
    """Share of each piece's sum in each box's mean."""


def _axis(pixels: int, boxes: int, fill: float, first: int, step: int) -> _Boxes:
    """Return the boxes of an axis on every ``step``-th of its pixels, from ``first`` on."""
    share = Fraction(fill).limit_denominator(10**6)
    side = share * pixels / boxes if boxes > 0 else Fraction(0)
    if side < step:
        colours = " of each colour" if step > 1 else ""
        most = math.floor(share * pixels / step)
        raise ValueError(
            f"{boxes} boxes of fill {fill:g} are not valid: use 1 to {most}, the number that hold "
            f"a pixel{colours} each of {pixels}, or a larger fill"
        )

    def below(position: Fraction) -> Fraction:
        """Return the length of such pixels below a position."""
        whole, rest = divmod(position - first, step)
        return max(Fraction(0), whole + min(Fraction(1), rest))

    middles = [Fraction((2 * box + 1) * pixels, 2 * boxes) for box in range(boxes)]
    edges = [(below(middle - side / 2), below(middle + side / 2)) for middle in middles]
    cuts = sorted(
        {whole(edge) for pair in edges for edge in pair for whole in (math.floor, math.ceil)}
    )
    shares = np.zeros((boxes, len(cuts) - 1))
    for box, (low, high) in enumerate(edges):
        for piece, (start, end) in enumerate(pairwise(cuts)):
            inside = min(high, Fraction(end)) - max(low, Fraction(start))
            if inside > 0:
                # Of the piece's sum, each of whose pixels is in the box by the same part.
                shares[box, piece] = float(inside / ((end - start) * (high - low)))
    return _Boxes(cuts, shares)
