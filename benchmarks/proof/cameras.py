"""Cameras drawn at random as they were built, and what a calibration believes of them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from benchmarks.proof.light import BINS, CHANNELS, Array, Field, Optics, Singles, Slits, centred

from veilcam_optics.camera.geometry import Camera, Scene
from veilcam_optics.camera.imperfections import Imperfections
from veilcam_optics.keys.masks import Levels

MARGIN = 3
"""Lines of the panel around its window that light passes too, as many as a pattern may shift by."""
ELECTRONS = 5.5, 7.5
"""Decades of electrons in a bin at full scale. The 4,014 pixels of an IMX477 in a bin hold some
8,000 each, 10^7.5; a hundredth of that is left where most of a frame is thrown away."""
MOST_READ_NOISE = 200.0
"""Of a bin [electrons]: 3 of each pixel."""
FIELD_PIXELS = 20
"""Of the field, across the task's square: 15 mrad each, 60 um on the sensor."""


@dataclass(frozen=True)
class Build:
    """A camera as it really is.

    Attributes:
        camera: as it was drawn.
        imperfections: in what it differs.
        leakage: amplitude that a filter passes of other colours.
        band: full width at half maximum of each channel's light [m].
        full_scale: measurement of saturated pixels.
        electrons: of a bin at full scale: they are its shot noise.
        read_noise: of a bin [electrons].
        hot: bins that a hot pixel marks as saturated, whatever the light, (rows, columns).
    """

    camera: Camera
    imperfections: Imperfections
    leakage: float
    band: float
    full_scale: float
    electrons: float
    read_noise: float
    hot: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]

    def patch(self, levels: Levels, *, around: int = 0, moved: tuple[int, int] = (0, 0)) -> Singles:
        """Amplitudes of the window and its margin; lines are dead within the window alone.

        Args:
            levels: that the panel holds, shape of the window.
            around: level outside of the window.
            moved: lines by which the panel shows them too far down and to the right.
        """
        lit = self.camera.panel.levels - 1
        told = np.full([side + 2 * MARGIN for side in levels.shape], around / lit)
        top, left = MARGIN + moved[0], MARGIN + moved[1]
        told[top : top + levels.shape[0], left : left + levels.shape[1]] = levels / lit
        real = self.imperfections
        shown = real.contrast_floor + (1 - real.contrast_floor) * told**real.gamma
        window = shown[MARGIN:-MARGIN, MARGIN:-MARGIN]
        window[list(real.dead_rows)] = real.dead_transmittance
        window[:, list(real.dead_columns)] = real.dead_transmittance
        return shown.astype(np.float32)

    def optics(self, scene: Scene, *, sides: tuple[float, float], depth: float) -> Optics:
        """The light from one depth.

        Args:
            scene: the task's.
            sides: of the field along y and x, in the task's squares.
            depth: [m], or infinite.
        """
        camera, real = self.camera, self.imperfections
        panel, sensor = camera.panel, camera.sensor
        square = scene.height / scene.distance
        above, beside = (
            Field(
                slopes=centred(round(side * FIELD_PIXELS)) * (square / FIELD_PIXELS),
                square=square,
                distance=camera.distance + real.distance_error,
                depth=depth,
            )
            for side in sides
        )
        lines = [side + 2 * MARGIN for side in camera.mask_shape]
        y = centred(lines[0]) * panel.pitch_y + real.shift_y
        x = centred(lines[1]) * panel.pitch_x + real.shift_x
        return Optics(
            rows=Slits(y, panel.aperture_y, sensor.height, BINS[0], above),
            columns=Slits(x, panel.aperture_x, sensor.width, BINS[1], beside),
            filters=self._filters(),
            spectra=tuple(tuple(_spectrum(each, self.band)) for each in self.camera.wavelengths),
            weights=self.camera.sensor.channel_weights,
            rotation=real.rotation,
        )

    def _filters(self) -> Array:
        """Share of a channel's light that each row of the patch passes, (channels, rows)."""
        cycle = self.camera.panel.filter_cycle
        rows = (
            self.camera.window.first_row - MARGIN + np.arange(self.camera.window.rows + 2 * MARGIN)
        )
        if not cycle:
            return np.ones((len(CHANNELS), len(rows)))
        own = np.array(cycle)[rows % len(cycle)] == np.array(CHANNELS)[:, None]
        return np.where(own, 1.0, self.leakage**2)


@dataclass(frozen=True)
class Belief:
    """What a calibration found.

    Attributes:
        imperfections: those of the camera, each with its error.
        gain: what is taken for 1, over what is.
        black: what is taken for no light, over what is [measurement].
    """

    imperfections: Imperfections
    gain: float
    black: float


def draw_build(
    camera: Camera, chance: np.random.Generator, electrons: float | None = None
) -> Build:
    """A camera as panels, glue and screws make it.

    Args:
        camera: as it was drawn.
        chance: source of the random numbers.
        electrons: of a bin at full scale; None draws them.
    """
    collected = 10 ** chance.uniform(*ELECTRONS)
    rows, columns = camera.mask_shape
    return Build(
        camera=camera,
        imperfections=Imperfections(
            shift_y=chance.uniform(-100e-6, 100e-6),
            shift_x=chance.uniform(-100e-6, 100e-6),
            rotation=chance.uniform(-4e-3, 4e-3),
            distance_error=chance.uniform(-120e-6, 120e-6),
            gamma=chance.uniform(0.8, 1.4),
            contrast_floor=chance.uniform(0, 0.1),
            dead_rows=(int(chance.integers(rows)),) if chance.random() < 0.2 else (),
            dead_columns=(int(chance.integers(columns)),) if chance.random() < 0.2 else (),
            dead_transmittance=chance.uniform(0, 1),
            stray_light=chance.uniform(0, 0.05),
        ),
        leakage=chance.uniform(0, 0.05),
        band=chance.uniform(0, 80e-9),
        full_scale=0.3,
        electrons=collected if electrons is None else electrons,
        read_noise=chance.uniform(0, MOST_READ_NOISE) if electrons is None else 0.0,
        hot=chance.random(BINS) < chance.choice([0.0, 0.02]),
    )


def draw_belief(build: Build, chance: np.random.Generator) -> Belief:
    """What calibrating a camera leaves: every number is a little off."""
    real = build.imperfections
    return Belief(
        replace(
            real,
            shift_y=real.shift_y + chance.normal(0, 2e-6),
            shift_x=real.shift_x + chance.normal(0, 2e-6),
            rotation=real.rotation + chance.normal(0, 0.2e-3),
            distance_error=real.distance_error + chance.normal(0, 10e-6),
            gamma=real.gamma * chance.uniform(0.95, 1.05),
            contrast_floor=max(0.0, real.contrast_floor + chance.normal(0, 3e-3)),
            dead_transmittance=min(1.0, real.dead_transmittance * chance.uniform(0.97, 1.03)),
            stray_light=max(0.0, real.stray_light + chance.normal(0, 3e-3)),
        ),
        gain=1 + chance.normal(0, 0.01),
        black=build.full_scale * chance.normal(0, 2e-5),
    )


def _spectrum(wavelength: float, band: float) -> Iterator[tuple[float, float]]:
    """Three nodes of a Gaussian band (Gauss and Hermite)."""
    deviation = band / math.sqrt(8 * math.log(2))
    for node, share in ((-math.sqrt(3), 1 / 6), (0.0, 2 / 3), (math.sqrt(3), 1 / 6)):
        yield wavelength + node * deviation, share
