"""Rig: captures of scenes behind masks by plain shadows, which the test knows nothing of.

A shadow is the mask correlated with the scene, on a grid of half a bin. Light comes from as far
to all sides as it can reach the sensor, and fades as what falls obliquely does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.keys.masks import Levels
from veilcam_optics.proof import PROOF

Array = npt.NDArray[np.float64]
Single = npt.NDArray[np.float32]
CAMERA = Camera()
UNCLIPPED = np.zeros(PROOF.shape, bool)
STEP = CAMERA.sensor.height / PROOF.rows / 2
"""Of the grid, on the sensor as on the mask [m]."""
PANEL = (88, 116)
"""Steps of the panel that light passes to a place of the sensor: a little more than the window."""
SIDES = tuple(2 * bins + lit for bins, lit in zip(PROOF.shape, PANEL, strict=True))
"""Of a scene, in steps: all directions from which light gets to the sensor."""


def mask(seed: int, camera: Camera = CAMERA) -> Levels:
    """One drawn at random."""
    levels: Levels = np.random.default_rng(seed).integers(
        0, camera.panel.levels, camera.mask_shape, dtype=np.uint8
    )
    return levels


def opened(levels: Levels, around: float = 0.0) -> Array:
    """Share of each step of the panel that is open: the window, and what is around it."""
    top = CAMERA.panel.levels - 1
    window, panel = np.square(levels / top), CAMERA.panel
    across = [
        _cover(count, lines, pitch, aperture)
        for count, lines, pitch, aperture in (
            (PANEL[0], levels.shape[0], panel.pitch_y, panel.aperture_y),
            (PANEL[1], levels.shape[1], panel.pitch_x, panel.aperture_x),
        )
    ]
    share: Array = across[0] @ (window - around) @ across[1].T + around * panel.fill_factor
    return share


def _cover(count: int, lines: int, pitch: float, aperture: float) -> Array:
    """Share of each step that each line's opening covers: (count, lines)."""
    edges = (np.arange(count + 1) - count / 2) * STEP
    centres = (np.arange(lines) - (lines - 1) / 2) * pitch
    inside = np.clip(edges[:, None] - (centres - aperture / 2), 0, aperture)
    covered: Array = np.diff(inside, axis=0) / STEP
    return covered


@dataclass(frozen=True)
class Room:
    """What is in front of the camera.

    Attributes:
        scene: light of each direction, of shape ``SIDES``.
    """

    scene: Array

    def behind(self, panel: Array) -> Array:
        """Light on the bins, 1 in the mean of an even scene without a panel."""
        faded = self._faded()
        shape = [side + lit for side, lit in zip(SIDES, PANEL, strict=True)]
        product = np.fft.rfft2(faded, shape) * np.conj(np.fft.rfft2(panel, shape))
        fine = np.fft.irfft2(product, shape)[: 2 * PROOF.rows, : 2 * PROOF.columns]
        # Through one hole, a place further to the right sees what is further to the left.
        fine = fine[::-1, ::-1]
        light: Array = fine.reshape(PROOF.rows, 2, PROOF.columns, 2).mean((1, 3)) / panel.size
        return light

    def behind_all_of(self, share: float) -> float:
        """Light behind a panel of which a share is open as far as light comes from."""
        return float(self._faded().sum()) * share / (PANEL[0] * PANEL[1])

    def _faded(self) -> Array:
        y, x = ((np.arange(side) - (side - 1) / 2) * STEP for side in SIDES)
        faded: Array = self.scene / np.square(1 + np.add.outer(y**2, x**2) / CAMERA.distance**2)
        return faded


def natural(seed: int, exponent: float = 1.0) -> Room:
    """Light everywhere, whose amplitudes fall as a power of the frequency, from 0.2 to 1."""
    chance = np.random.default_rng(seed)
    frequency = np.hypot(np.fft.fftfreq(SIDES[0])[:, None], np.fft.rfftfreq(SIDES[1]))
    spectrum = np.fft.rfft2(chance.standard_normal(SIDES))
    spectrum /= np.maximum(frequency, 1 / max(SIDES)) ** exponent
    picture = np.fft.irfft2(spectrum, SIDES)
    low, high = np.min(picture), np.max(picture)
    return Room(0.2 + 0.8 * (picture - low) / (high - low))


def figure(seed: int) -> Room:
    """A few strokes on black, as a digit would be, in the middle of the field."""
    chance = np.random.default_rng(seed)
    scene = np.zeros(SIDES)
    middle = np.array(SIDES) // 2
    for _ in range(4):
        top, left = middle + chance.integers(-12, 8, 2)
        high, wide = (3, 12) if chance.random() < 0.5 else (12, 3)
        scene[top : top + high, left : left + wide] = 1
    return Room(scene)


def wall() -> Room:
    """White, as far as light comes from."""
    return Room(np.ones(SIDES))


def measured(light: Array, seed: int, snr_db: float = 80.0) -> Single:
    """Light with shot noise, which at ``snr_db`` is that of a capture's 24 x 32 bins."""
    chance = np.random.default_rng(seed)
    unit = 4 * np.square(light).sum() / light.sum() * 10 ** (-snr_db / 10)
    noisy = light + np.sqrt(light.clip(0) * unit) * chance.standard_normal(light.shape)
    capture: Single = noisy.astype(np.float32)
    return capture
