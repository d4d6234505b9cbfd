"""The mark of a mask: texture and phases of its spectrum, as light from anywhere leaves them.

The numbers in brackets are those of docs/proof.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from veilcam_optics.arrays import overwrite
from veilcam_optics.camera.geometry import CHANNELS, Camera, Embedding
from veilcam_optics.camera.imperfections import Imperfections
from veilcam_optics.proof.traces import lowest

Array = npt.NDArray[np.float64]
Field = npt.NDArray[np.complex128]

_DISTANCE = 0.6
"""Of scenes whose shadows are as large as they are on average, between 0.3 m and infinity [m]."""
_FOLDS = np.array([-1, 0, 1])
"""Multiples of the sampling frequency from which finer texture is folded back."""
_COARSEST = 12e-3
"""Wavelength on the sensor up to which the power of scenes grows [m]."""
_AROUND = 4
"""Frequencies to each side over which the level of a spectrum is taken."""
_NOT_FOLDED = 1
"""Place of frequencies among their folds."""
_BORNE = 0.5
"""Share of a mark that a trace bears, for which its frequencies are weighed best."""
_LEAST = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class Mark:
    """What a mask leaves in captures. As secret as the mask, so its repr holds nothing.

    Attributes:
        texture: by how much its spectrum is above its own level at each frequency (eq. 2),
            (2 x rows, columns + 1) of the bins, as :func:`numpy.fft.rfft2` orders them.
        phases: conjugate, of modulus 1, at the lowest frequencies, (rows, columns * 3 / 8 + 1):
            half of them along y, three eighths along x.
    """

    texture: npt.NDArray[np.float32] = field(repr=False)
    phases: npt.NDArray[np.complex64] = field(repr=False)

    def weighed(self) -> Self:
        """The same with what power at each frequency says for the mask as its texture (eq. 5)."""
        return replace(self, texture=self.texture / (1 + _BORNE * self.texture))

    def erase(self) -> None:
        """Overwrite it, as well as Python lets us."""
        overwrite(self.texture, self.phases.view(np.float32))


@dataclass(frozen=True)
class _Axis:
    """One axis of mask and sensor.

    Attributes:
        frequencies: of a spectrum, and beside each those that fold onto it (folds, count) [1/m].
        waves: at the places of the apertures, (folds, count, apertures).
        opened: Fourier transform of the light behind one aperture, (channels, folds, count).
        binned: power that averaging over a bin leaves, (folds, count).
    """

    frequencies: Array
    waves: npt.NDArray[np.complex128]
    opened: Array
    binned: Array


class Marks:
    """Makes the marks of one camera's masks.

    Light from all directions is alike, so that what falls on the sensor is a stationary field. Its
    spectrum is that of the mask times that of the scene (eq. 1); neither knows where the mask is.

    Args:
        camera: nominal geometry.
        imperfections: of the camera as it was measured.
        bins: of the sensor.
    """

    def __init__(self, camera: Camera, imperfections: Imperfections, bins: Embedding) -> None:
        self._camera, self._imperfections = camera, imperfections
        distance = imperfections.actual(camera).distance
        panel, sensor, channels = camera.panel, camera.sensor, range(len(CHANNELS))
        self._y, self._x = (
            _axis(
                np.fft.fftfreq(2 * count) if axis == "y" else np.fft.rfftfreq(2 * count),
                side / count,
                np.array(centres) * (1 + distance / _DISTANCE),
                [_slit(opening, camera.wavelengths[each], distance) for each in channels],
            )
            for axis, count, side, centres, opening in (
                ("y", bins.rows, sensor.height, camera.row_centres, panel.aperture_y),
                ("x", bins.columns, sensor.width, camera.column_centres, panel.aperture_x),
            )
        )
        self._filters = np.array(
            [
                sensor.channel_weights[each] * np.square(camera.row_amplitudes(each))
                for each in channels
            ]
        )
        squares = np.add.outer(self._y.frequencies**2, self._x.frequencies**2)
        self._scene = np.multiply.outer(self._y.binned, self._x.binned) / (
            squares + 1 / _COARSEST**2
        )
        self._smoothing = _lags(2 * bins.rows)[:, None] * _lags(2 * bins.columns)
        every = self._passed(np.arange(panel.levels, dtype=np.uint8))
        even = self._light(np.full(camera.mask_shape, every.mean()))
        self._usual = self._folded(np.square(np.abs(even)))
        self._usual += every.var() * self._white()

    def mark(self, transmittance: Array) -> Mark:
        """The mark of one mask.

        Args:
            transmittance: intensity that each sub-pixel passes, the window's shape.
        """
        light = self._light(transmittance)
        relative = self._folded(np.square(np.abs(light))) / self._usual
        level = np.fft.rfft2(np.fft.irfft2(relative, self._smoothing.shape) * self._smoothing).real
        plain = lowest(light[_NOT_FOLDED, :, _NOT_FOLDED])
        phases = plain.conj() / np.maximum(np.abs(plain), _LEAST)
        return Mark(
            (relative / level - 1).astype(np.float32), phases.astype(np.complex64, order="C")
        )

    def shown(self, levels: npt.NDArray[np.uint8]) -> Array:
        """Intensity that each sub-pixel passes when the panel is told ``levels``."""
        real = self._imperfections
        passed = self._passed(levels)
        passed[list(real.dead_rows)] = real.dead_transmittance**2
        passed[:, list(real.dead_columns)] = real.dead_transmittance**2
        return passed

    def _passed(self, levels: npt.NDArray[np.uint8]) -> Array:
        real = self._imperfections
        told = (levels / (self._camera.panel.levels - 1)) ** real.gamma
        passed: Array = np.square(real.contrast_floor + (1 - real.contrast_floor) * told)
        return passed

    def _light(self, transmittance: Array) -> Field:
        """Fourier transform of the light behind a mask, (folds, rows, folds, columns)."""
        light: Field | float = 0.0
        for filters, down, across in zip(
            self._filters, self._y.opened, self._x.opened, strict=True
        ):
            rows = down[..., None] * (self._y.waves * filters) @ transmittance
            light = light + np.einsum(
                "fyc,gxc->fygx", rows, across[..., None] * self._x.waves, optimize=True
            )
        return np.asarray(light)

    def _white(self) -> Array:
        """Power that sub-pixels of variance 1 leave which are independent of each other."""
        total = 0.0
        for filters in self._filters.T:
            one = np.einsum("c,cfy,cgx->fygx", filters, self._y.opened, self._x.opened)
            total = total + np.square(one)
        return self._folded(total * self._x.waves.shape[-1])

    def _folded(self, power: Array) -> Array:
        """Power at each frequency of a scene like any other (eq. 1)."""
        folded: Array = (power * self._scene).sum((0, 2))
        return folded


@dataclass(frozen=True)
class _Slit:
    """Light behind one slit, by Fresnel diffraction."""

    width: float
    spread: float

    def transform(self, frequencies: Array) -> Array:
        """Fourier transform of its intensity: what of it two edges, moved apart, have in common."""
        open_share = np.maximum(self.width - self.spread * np.abs(frequencies), 0)
        transform: Array = open_share * np.sinc(frequencies * open_share)
        return transform


def _slit(width: float, wavelength: float, distance: float) -> _Slit:
    return _Slit(width, wavelength * distance)


def _axis(
    relative: npt.NDArray[np.floating], bin_side: float, centres: Array, slits: Sequence[_Slit]
) -> _Axis:
    """One axis.

    Args:
        relative: frequencies over that of the bins.
        bin_side: side of a bin [m].
        centres: of the apertures' shadows [m].
        slits: an aperture, for each channel.
    """
    frequencies = (relative + _FOLDS[:, None]) / bin_side
    return _Axis(
        frequencies,
        np.exp(-2j * np.pi * frequencies[..., None] * centres),
        np.stack([slit.transform(frequencies) for slit in slits]),
        np.sinc(frequencies * bin_side) ** 2,
    )


def _lags(count: int) -> Array:
    """What a mean over neighbouring frequencies does to each lag (Dirichlet's kernel)."""
    width = 2 * _AROUND + 1
    turns = np.pi * np.arange(1, count) / count
    return np.concatenate([[1.0], np.sin(width * turns) / (width * np.sin(turns))])


def even_light(camera: Camera, bins: Embedding) -> npt.NDArray[np.float32]:
    """Light of an evenly bright half space behind the window, of shape ``bins``, 1 in the mean.

    What falls obliquely fades with the fourth power of the cosine.
    """
    slopes_y, slopes_x = (
        np.subtract.outer(_middles(count, side), np.array(centres)) / camera.distance
        for count, side, centres in (
            (bins.rows, camera.sensor.height, camera.row_centres),
            (bins.columns, camera.sensor.width, camera.column_centres),
        )
    )
    columns = 1 + np.square(slopes_x)
    light = np.stack(
        [(1 / np.square(np.square(row)[:, None, None] + columns)).sum((0, 2)) for row in slopes_y]
    )
    even: npt.NDArray[np.float32] = (light / light.mean()).astype(np.float32)
    return even


def _middles(count: int, side: float) -> Array:
    """Middles of the bins that a side is cut into [m]."""
    middles: Array = ((np.arange(count) + 0.5) / count - 0.5) * side
    return middles
