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
_SMOOTH = slice(0, 3), slice(1, 7)
"""Cosines along y and x that tell how even light is. Flicker is in none of even light's: all of a
row is read at the same time."""


@dataclass(frozen=True)
class Trace:
    """Of captures.

    Attributes:
        power: at each frequency, ordered as a mark, and as often as the whole plane has it:
            (captures, frequencies).
        picture: amplitude at the lowest frequencies, (captures, rows, columns * 3 / 8 + 1): half of
            them along y, three eighths along x, where little passes apertures beyond.
        unevenness: of the light, over its mean (eq. 12), (captures,).
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
        self._spectra = _Spectra(bins)
        row, column = np.arange(bins.rows)[:, None], np.arange(bins.columns)
        self._kept = np.float32((row >= _LOWEST) & (column >= _LOWEST))
        beyond = (row > _BEYOND[0] * bins.rows) & (column > _BEYOND[1] * bins.columns)
        self._beyond = np.float32(beyond.ravel() / beyond.sum())

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
        power, picture = self._spectra.of(signal * cosines / np.sqrt(level))
        first, smooth = cosines[:, 0, 0], cosines[:, *_SMOOTH]
        uneven = np.square(smooth).sum((1, 2)) / np.maximum(np.square(first), np.float32(_LEAST))
        return Trace(
            power,
            picture,
            np.sqrt(uneven).astype(np.float32),
            (first / (self._bins.rows * self._bins.columns) ** 0.5).astype(np.float32),
        )

    def _filled(self, measurement: Single, clipped: Bools) -> Single:
        """What is clipped taken from what surrounds it: what that adds counts as noise."""
        known = np.float32(~clipped)
        weight = self._near_y @ known @ self._near_x
        nearby = self._near_y @ (measurement * known) @ self._near_x
        filled: Single = np.where(clipped, nearby / np.maximum(weight, _LEAST), measurement)
        return filled


class _Spectra:
    """Spectra of pictures given by their cosines, on twice as fine a grid of frequencies (eq. 3).

    A cosine's own spectrum is known, so that two products of matrices are all of it; that is
    faster than to transform back and forth.

    Args:
        bins: of the sensor.
    """

    def __init__(self, bins: Embedding) -> None:
        self._bins = bins
        down, across = (_cosines(count) @ _turns(count) for count in bins.shape)
        self._down: Single = np.concatenate([down.T.real, down.T.imag]).astype(np.float32)
        # How often each column of a half plane of frequencies is in the whole one.
        often = np.full(bins.columns + 1, 2.0)
        often[[0, -1]] = 1
        across = across * np.sqrt(often)
        self._across: Single = np.hstack([across.real, across.imag]).astype(np.float32)
        self._lowest = _lowest(2 * bins.rows, bins.columns + 1)
        self._once: Single = np.sqrt(1 / often[: self._lowest[1]]).astype(np.float32)

    def of(self, cosines: Single) -> tuple[Single, Complex]:
        """Power and lowest amplitudes, as a trace has them.

        Args:
            cosines: (captures, *shape of the bins).
        """
        rows, columns = self._bins.rows + 1, self._bins.columns + 1
        product: Single = self._down @ (cosines @ self._across)
        # Real and imaginary, along y first.
        (rr, ri), (ir, ii) = (
            (half[..., :columns], half[..., columns:])
            for half in (product[:, :rows], product[:, rows:])
        )
        even = np.square(rr) + np.square(ii) + np.square(ri) + np.square(ir)
        odd = 2 * (ri * ir - rr * ii)
        # Of frequencies below zero along y, whose turns are the other way round, after all others.
        power = np.concatenate([even + odd, (even - odd)[:, -2:0:-1]], 1)
        return power.reshape(len(cosines), -1), self._lower(rr, ri, ir, ii)

    def _lower(self, rr: Single, ri: Single, ir: Single, ii: Single) -> Complex:
        rows, columns = self._lowest
        rr, ri, ir, ii = (each[:, : rows + 1, :columns] for each in (rr, ri, ir, ii))
        lower = np.empty((len(rr), 2 * rows, columns), np.complex64)
        lower.real[:, :rows], lower.imag[:, :rows] = (rr - ii)[:, :-1], (ri + ir)[:, :-1]
        lower.real[:, rows:], lower.imag[:, rows:] = (rr + ii)[:, :0:-1], (ri - ir)[:, :0:-1]
        lower *= self._once
        return lower


def lowest(spectrum: npt.NDArray[np.complex128]) -> npt.NDArray[np.complex128]:
    """The lowest frequencies along each axis, as a trace's picture has them.

    Args:
        spectrum: (..., rows, columns), as :func:`numpy.fft.rfft2` orders frequencies.
    """
    rows, columns = _lowest(*spectrum.shape[-2:])
    return np.concatenate([spectrum[..., :rows, :columns], spectrum[..., -rows:, :columns]], -2)


def _lowest(rows: int, columns: int) -> tuple[int, int]:
    """Frequencies to each side of zero along y, and from zero on along x, that pictures have."""
    return rows // 4, (columns - 1) * 3 // 8 + 1


def _cosines(count: int) -> Single:
    """The discrete cosine transform, orthonormal: (count, count)."""
    turns = np.pi * np.arange(count)[:, None] * (np.arange(count) + 0.5) / count
    matrix = np.sqrt(2 / count) * np.cos(turns)
    matrix[0] /= np.sqrt(2)
    cosines: Single = matrix.astype(np.float32)
    return cosines


def _turns(count: int) -> npt.NDArray[np.complex128]:
    """The Fourier transform at frequencies from 0 on, twice as dense: (count, count + 1)."""
    cycles = np.outer(np.arange(count), np.arange(count + 1)) / (2 * count)
    turns: npt.NDArray[np.complex128] = np.exp(-2j * np.pi * cycles)
    return turns


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
