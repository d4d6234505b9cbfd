"""Light behind a mask by shadows and Fresnel diffraction, apart from the optics that it judges.

A sub-pixel's light falls apart into a factor along y and one along x. Each is the intensity of one
slit, averaged over a bin of the sensor and a pixel of the field. Slits do not interfere here: those
of one colour are so far apart that their fringes, some 10 um, average out over a bin of 98 um.

The field is given in slopes, the tangents of angles from the axis, and is as wide as asked for. A
value of 1 is what it is to the package: the task's square, white, without a mask.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.special import fresnel

Array = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]
Spectrum = tuple[tuple[float, float], ...]
"""Wavelengths [m] and their shares."""

BINS = (48, 64)
"""Of the sensor, as a capture is tested."""
CHANNELS = range(3)
STEP = 1.5e-6
"""Between nodes of a slit's profile [m]."""
REACH = 3e-3
"""From a slit's middle to where its light is no longer followed; 0.2 % fall beyond [m]."""
OBLIQUITIES = (1.0, 1.3, 1.8, 3.0)
"""Nodes of what a slope stretches wavelengths by."""
NODES = (-1, 0, 1)
TURN = 15e-6
"""Displacement of a row's nodes, between which a rotated mask is interpolated [m]."""


def centred(count: int) -> Array:
    """So many places, 1 apart, around 0."""
    places: Array = np.arange(count, dtype=np.float64) - (count - 1) / 2
    return places


@dataclass(frozen=True)
class Field:
    """Where light comes from, along one axis.

    Attributes:
        slopes: of the middles of its pixels, evenly spaced.
        square: slope across the task's square.
        distance: mask to sensor [m].
        depth: scene to mask [m], or infinite.
    """

    slopes: Array
    square: float
    distance: float
    depth: float

    @property
    def magnification(self) -> float:
        """How much larger a shadow is than what casts it."""
        return 1 + self.distance / self.depth

    @property
    def spacing(self) -> float:
        """Slope across one pixel."""
        return float(self.slopes[1] - self.slopes[0])


@dataclass(frozen=True)
class Slits:
    """Equal slits along one axis, and the bins and field pixels that see each other through them.

    Attributes:
        centres: of the slits, on the mask [m].
        width: open part of a slit [m].
        side: of the sensor [m].
        bins: that it is cut into.
        field: in front of them.
    """

    centres: Array
    width: float
    side: float
    bins: int
    field: Field

    def factors(self, spectrum: Spectrum, moves: Sequence[float] = (0.0,)) -> list[Singles]:
        """Light of a white pixel of the field in a bin, through a slit: (slopes, bins, slits).

        Args:
            spectrum: of the light.
            moves: of all slits [m]; one result for each.
        """
        kernels = np.stack([self._kernel(spectrum, stretch) for stretch in OBLIQUITIES])
        return [self._moved(kernels, move) for move in moves]

    def _moved(self, kernels: Array, move: float) -> Singles:
        offsets = (self._seen[:, :, None] - self.centres - move) / STEP
        middle = len(self._nodes) // 2
        cell = np.floor(offsets).astype(np.intp)
        part = offsets - cell
        cell = np.clip(cell + middle, 0, len(self._nodes) - 2)
        stretch = np.clip((1 + self.field.slopes**2) ** 1.5, OBLIQUITIES[0], OBLIQUITIES[-1])
        place = np.interp(stretch, OBLIQUITIES, range(len(OBLIQUITIES)))
        below = np.minimum(place.astype(np.intp), len(OBLIQUITIES) - 2)
        upper = (place - below)[:, None, None]
        lines = [
            (1 - part) * kernels[node[:, None, None], cell]
            + part * kernels[node[:, None, None], cell + 1]
            for node in (below, below + 1)
        ]
        share = self.field.spacing / self.field.square / self.field.magnification
        return (share * ((1 - upper) * lines[0] + upper * lines[1])).astype(np.float32)

    @cached_property
    def _seen(self) -> Array:
        """Where on the mask a bin's middle and a slope meet: (slopes, bins)."""
        middles = centred(self.bins) * (self.side / self.bins)
        ahead: Array = middles + self.field.slopes[:, None] * self.field.distance
        return ahead / self.field.magnification

    @cached_property
    def _nodes(self) -> Array:
        farthest = float(np.abs(self._seen).max() + np.abs(self.centres).max()) + self._box_sum
        half = int(farthest / STEP) + 4
        return STEP * np.arange(-half, half + 1, dtype=np.float64)

    @property
    def _box_sum(self) -> float:
        return sum(self._boxes)

    @property
    def _boxes(self) -> tuple[float, float]:
        """A bin and a field pixel, as wide as they are seen on the mask [m]."""
        scale = 1 / self.field.magnification
        return self.side / self.bins * scale, self.field.spacing * self.field.distance * scale

    def _kernel(self, spectrum: Spectrum, stretch: float) -> Array:
        """Profile of a slit averaged over both boxes, on the nodes."""
        near = np.abs(self._nodes) <= REACH
        profile = np.zeros(len(self._nodes))
        for wavelength, share in spectrum:
            spread = wavelength * stretch * self.field.distance / self.field.magnification
            profile[near] += share * slit_profile(self._nodes[near], self.width, spread)
        for box in self._boxes:
            profile = _averaged(profile, box)
        return profile


def slit_profile(at: Array, width: float, spread: float) -> Array:
    """Intensity behind a slit under light of intensity 1 (Born and Wolf, section 8.7).

    Args:
        at: distances from the slit's middle [m].
        width: of the slit [m].
        spread: wavelength times distance [m^2].
    """
    scale = (2 / spread) ** 0.5
    upper, lower = (np.stack(fresnel(scale * (at + side * width / 2))) for side in (1, -1))
    intensity: Array = ((upper - lower) ** 2).sum(0) / 2
    return intensity


def _averaged(profile: Array, box: float) -> Array:
    """Mean of a profile on its nodes over a box around each of them."""
    total = np.concatenate([[0.0], np.cumsum((profile[1:] + profile[:-1]) * (STEP / 2))])
    nodes = STEP * np.arange(len(profile))
    ends = [np.interp(nodes + side * box / 2, nodes, total) for side in (1, -1)]
    averaged: Array = (ends[0] - ends[1]) / box
    return averaged


@dataclass(frozen=True)
class Optics:
    """Panel in front of a sensor, from one depth: what scenes give behind amplitudes of its patch.

    Attributes:
        rows: slits along y.
        columns: slits along x.
        filters: share of a channel's light that a row passes, (channels, rows).
        spectra: of the channels.
        weights: share of each channel in a measurement.
        rotation: of the mask, from x towards y [rad].
    """

    rows: Slits
    columns: Slits
    filters: Array
    spectra: tuple[Spectrum, ...]
    weights: tuple[float, ...]
    rotation: float = 0.0

    def measurements(self, scenes: Singles, patches: Singles) -> Singles:
        """What is on the sensor, without stray light.

        Args:
            scenes: (scenes, channels, slopes along y, slopes along x).
            patches: amplitudes of the panel, (patches, rows, columns).

        Returns:
            (patches, scenes, *BINS).
        """
        total = np.zeros((len(patches), len(scenes), *BINS), np.float32)
        open_share = patches.astype(np.float64) ** 2
        for channel in CHANNELS:
            down = self._down(channel, open_share)
            for rows, columns in zip(down, self._across(channel), strict=True):
                spread = _spread(scenes[:, channel], columns)
                total += np.float32(self.weights[channel]) * _gathered(spread, rows)
        return total

    def uncovered(self, scenes: Singles) -> Singles:
        """What is on the sensor behind a panel that is open everywhere: the same in every place.

        Args:
            scenes: (scenes, channels, slopes along y, slopes along x).

        Returns:
            (scenes,).
        """
        share = np.array(self.weights) * self.filters.mean(1)
        for slits in (self.rows, self.columns):
            pitch = float(np.diff(slits.centres).mean())
            field = slits.field
            share *= slits.width / pitch * field.spacing / field.square / field.magnification
        light: Singles = (scenes.sum((2, 3)) @ share).astype(np.float32)
        return light

    def _down(self, channel: int, open_share: Array) -> tuple[Singles, Singles]:
        """Rows' factors by columns, (slopes, columns, patches x bins), and their share that turns.

        In a turned mask a column's slits lie higher or lower: three displacements are interpolated.
        A row's lie to the right or left, to first order.
        """
        spectrum, passed = self.spectra[channel], self.filters[channel]
        factors = self.rows.factors(spectrum, [node * TURN for node in NODES])
        lift = self.rotation * (self.columns.centres - self.columns.centres.mean()) / TURN
        weights = (lift * (lift - 1) / 2, 1 - lift**2, lift * (lift + 1) / 2)
        used = np.flatnonzero(passed)
        shares = open_share[:, used] * passed[used, None]
        push = -self.rotation * (self.rows.centres - self.rows.centres.mean())[used]
        straight = [
            _mixed(factor[:, :, used], shares * weight)
            for factor, weight in zip(factors, weights, strict=True)
        ]
        return sum(straight[1:], straight[0]), _mixed(
            factors[1][:, :, used], shares * push[:, None]
        )

    def _across(self, channel: int) -> tuple[Singles, Singles]:
        """Columns' factors, and their change where they move to the right."""
        small = 4e-6
        behind, here, ahead = self.columns.factors(self.spectra[channel], (-small, 0, small))
        return here, (ahead - behind) / np.float32(2 * small)


def _mixed(factors: Singles, shares: Array) -> Singles:
    """(slopes, bins, rows) by (patches, rows, columns) to (slopes, columns, patches x bins)."""
    slopes, bins, rows = factors.shape
    patches, _, columns = shares.shape
    wide = shares.transpose(1, 2, 0).reshape(rows, -1).astype(np.float32)
    product = (factors.reshape(-1, rows) @ wide).reshape(slopes, bins, columns, patches)
    return np.ascontiguousarray(product.transpose(0, 2, 3, 1)).reshape(slopes, columns, -1)


def _spread(scenes: Singles, columns: Singles) -> Singles:
    """Scenes (scenes, y, x) by columns' factors (x, bins, slits): (bins, scenes, y x slits)."""
    count, height, width = scenes.shape
    _, bins, slits = columns.shape
    product = scenes.reshape(-1, width) @ columns.reshape(width, -1)
    ordered = product.reshape(count, height, bins, slits).transpose(2, 0, 1, 3)
    return np.ascontiguousarray(ordered).reshape(bins, count, -1)


def _gathered(spread: Singles, rows: Singles) -> Singles:
    """(bins along x, scenes, y x slits) by (y, slits, patches x bins): (patches, scenes, *BINS)."""
    product = spread @ rows.reshape(spread.shape[2], -1)
    shaped = product.reshape(*spread.shape[:2], -1, BINS[0])
    return np.ascontiguousarray(shaped.transpose(2, 1, 3, 0))
