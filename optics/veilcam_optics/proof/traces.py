"""The trace that a mask leaves in a capture: its spectrum, freed of scene and noise.

The numbers in brackets are those of docs/proof.md.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from veilcam_optics.camera.geometry import Embedding

Single = npt.NDArray[np.float32]
Bools = npt.NDArray[np.bool_]
Complex = npt.NDArray[np.complex64]

_LOWEST = 3
"""Cosines along each axis that are left out: lamps that flicker, and light that falls off."""
_AROUND = 2
"""Cosines to each side over which the level of a capture is taken."""
_BEYOND = (0.5, 0.9)
"""Frequencies along y and x, over the highest, from which on apertures pass next to nothing."""
_REACH = 1.0
"""Distance over which what surrounds a clipped bin counts e times less [bins]."""
_LEAST = float(np.finfo(np.float32).tiny)
_PROFILE = slice(1, 7)
"""Cosines of the profile along x."""


@dataclass(frozen=True)
class Trace:
    """Of captures.

    Attributes:
        power: at each frequency, ordered as a mark, and as often as the whole plane has it:
            (captures, frequencies).
        picture: amplitude at the lower half of the frequencies along each axis,
            (captures, rows, columns // 2 + 1).
        unevenness: of the light along x, over its mean (eq. 7), (captures,).
        mean: of the measurements, (captures,).
    """

    power: Single
    picture: Complex
    unevenness: Single
    mean: Single


class Traces:
    """Takes traces.

    Args:
        bins: of the sensor.
    """

    def __init__(self, bins: Embedding) -> None:
        self._bins = bins
        self._y, self._x = _cosines(bins.rows), _cosines(bins.columns)
        self._mean_y, self._mean_x = _means(bins.rows), _means(bins.columns)
        self._near_y, self._near_x = _near(bins.rows), _near(bins.columns)
        row, column = np.arange(bins.rows)[:, None], np.arange(bins.columns)
        self._kept = np.float32((row >= _LOWEST) & (column >= _LOWEST))
        beyond = (row > _BEYOND[0] * bins.rows) & (column > _BEYOND[1] * bins.columns)
        self._beyond = np.float32(beyond.ravel() / beyond.sum())
        # How often each column of a half plane of frequencies is in the whole one.
        self._weights = np.full(bins.columns + 1, 2, np.float32)
        self._weights[[0, -1]] = 1

    def take(self, measurement: Single, clipped: Bools) -> Trace:
        """The traces in captures.

        Args:
            measurement: (captures, *shape of the bins).
            clipped: which of them hold a saturated pixel.
        """
        whole = self._filled(measurement, clipped) if clipped.any() else measurement
        cosines = self._y @ whole @ self._x.T
        power = np.square(cosines)
        level = self._mean_y @ power @ self._mean_x.T
        noise = (power.reshape(len(whole), -1) @ self._beyond)[:, None, None]
        # Nothing is divided by zero where there is no light at all.
        level = np.maximum(level, _LEAST)
        signal = np.maximum(1 - noise / level, 0) * self._kept
        white = self._y.T @ (signal * cosines / np.sqrt(level)) @ self._x
        spectrum = np.fft.rfft2(white, (2 * self._bins.rows, 2 * self._bins.columns))
        squares = np.square(spectrum.real) + np.square(spectrum.imag)
        # The first row of cosines are those of the profile along x.
        first, profile = cosines[:, 0, 0], np.square(cosines[:, 0, _PROFILE]).sum(1)
        unevenness: Single = np.sqrt(
            profile / np.maximum(np.square(first), np.float32(_LEAST))
        ).astype(np.float32)
        return Trace(
            (squares * self._weights).reshape(len(whole), -1),
            lower_half(spectrum).astype(np.complex64),
            unevenness,
            (first / (self._bins.rows * self._bins.columns) ** 0.5).astype(np.float32),
        )

    def _filled(self, measurement: Single, clipped: Bools) -> Single:
        """What is clipped taken from what surrounds it: what that adds counts as noise."""
        known = np.float32(~clipped)
        weight = self._near_y @ known @ self._near_x
        nearby = self._near_y @ (measurement * known) @ self._near_x
        filled: Single = np.where(clipped, nearby / np.maximum(weight, _LEAST), measurement)
        return filled


def lower_half(spectrum: npt.NDArray[np.complex128]) -> npt.NDArray[np.complex128]:
    """The lower half of the frequencies along each axis.

    Args:
        spectrum: (..., rows, columns), as :func:`numpy.fft.rfft2` orders frequencies.
    """
    rows, columns = spectrum.shape[-2] // 4, spectrum.shape[-1] // 2 + 1
    return np.concatenate([spectrum[..., :rows, :columns], spectrum[..., -rows:, :columns]], -2)


def _cosines(count: int) -> Single:
    """The discrete cosine transform, orthonormal: (count, count)."""
    turns = np.pi * np.arange(count)[:, None] * (np.arange(count) + 0.5) / count
    matrix = np.sqrt(2 / count) * np.cos(turns)
    matrix[0] /= np.sqrt(2)
    cosines: Single = matrix.astype(np.float32)
    return cosines


def _means(count: int) -> Single:
    """Means over neighbours, mirrored at the ends: (count, count)."""
    places = np.arange(count)[:, None] + np.arange(-_AROUND, _AROUND + 1)
    places = np.where(places < 0, -1 - places, places)
    places = np.where(places >= count, 2 * count - 1 - places, places)
    matrix = np.zeros((count, count), np.float32)
    np.add.at(matrix, (np.arange(count)[:, None], places), 1 / (2 * _AROUND + 1))
    return matrix


def _near(count: int) -> Single:
    """Weights of neighbours: (count, count)."""
    places = np.arange(count)
    near: Single = np.exp(-np.abs(np.subtract.outer(places, places)) / _REACH).astype(np.float32)
    return near
