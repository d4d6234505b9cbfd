"""Exact scalar light from points of a scene through a panel to a sensor, by direct summation.

NumPy and float64 alone; nothing of the product is used. A spherical wave from every scene pixel's
centre falls on the panel; every open cell of it sends on a wave of Rayleigh and Sommerfeld's first
kind (Goodman, Introduction to Fourier Optics, 3rd ed., equation 3-41). No angle is taken for small.
The irradiance is the flux through the sensor's plane, Im(U* dU/dz) / k; a scene pixel sends light
by Lambert's law. A scene pixel is ``sources x sources`` points, each of whose light is moved over
its own part of the pixel's geometric image, as bright as that part is on average.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

LEAST_SAMPLES = 3.0
"""Samples in the shortest wave that a cell's light makes on the sensor, against the scene's."""

_COARSER = (1.0, 0.7, 0.5, 0.35, 0.25)
"""A cell's light is right to first order in any direction, so that a coarser one is less exact, and
not wrong: who uses it compares with one half as wide."""


@dataclass(frozen=True)
class Beam:
    """Light of one wavelength [m] from one distance [m], and its share in a gray measurement."""

    channel: int
    wavelength: float
    scene_distance: float
    share: float


@dataclass(frozen=True)
class Axis:
    apertures: int
    pitch: float
    open_parts: int
    """Of ``parts`` equal parts of the pitch, in the middle."""
    parts: int
    sensor: float
    pixels: int
    scene_pixels: int
    scene_pixel: float
    shift: float = 0.0
    fill: float = 1.0
    """Side of the averaged box in the middle of a pixel, as a share of the pixel."""
    scene_shift: float = 0.0

    @property
    def mask(self) -> float:
        return self.apertures * self.pitch


@dataclass(frozen=True)
class Light:
    y: Axis
    x: Axis
    distance: float
    beams: tuple[Beam, ...]
    rotation: float = 0.0
    shares: Array | None = field(default=None, compare=False)
    """Share of each channel in each embedding pixel, (3, rows, columns), instead of the beams'."""
    sources: int = 1

    def finest(self, axis: Axis) -> float:
        wanted = math.inf
        for beam in self.beams:
            image = axis.scene_pixel * self.distance / beam.scene_distance
            side = (axis.mask + axis.sensor + image) / 2 + abs(axis.shift)
            if self.rotation:
                side += abs(self.rotation) * max(self.y.mask + self.y.sensor, self.x.mask)
            tilt = axis.scene_pixels * axis.scene_pixel / 2 / beam.scene_distance
            sine = min(1.0, side / math.hypot(side, self.distance) + math.sin(math.atan(tilt)))
            wanted = min(wanted, beam.wavelength / sine / LEAST_SAMPLES)
        # Light is averaged over a source's image and over a box: the wider one holds eight cells.
        image = min(axis.scene_pixel * self.distance / b.scene_distance for b in self.beams)
        pixel = axis.sensor / axis.pixels
        box = min(pixel, max(axis.fill * pixel, image / self.sources, pixel / 16))
        return min(wanted, self.distance / 6, box / 8)

    def cells(self, axis: Axis, finer: float = 1.0, times: int = 1) -> int:
        return times * max(1, math.ceil(axis.pitch / axis.parts / self.finest(axis) * finer))

    def lengths(self, finer: float = 1.0, times: int = 1) -> tuple[int, int]:
        found = []
        for axis in (self.y, self.x):
            cell = axis.pitch / axis.parts / self.cells(axis, finer, times)
            found.append(_fast(math.ceil((axis.mask + self.seen(axis)) / cell) + 2))
        return found[0], found[1]

    def seen(self, axis: Axis) -> float:
        image = max(axis.scene_pixel * self.distance / b.scene_distance for b in self.beams)
        length = axis.sensor + image
        if self.rotation:
            length += abs(self.rotation) * max(self.y.sensor, self.x.sensor) + image
        return length

    def work(self, finer: float = 1.0, times: int = 1) -> float:
        rows, columns = self.lengths(finer, times)
        points = self.y.scene_pixels * self.x.scene_pixels * self.sources**2
        return float(rows) * columns * len(self.beams) * points

    def affordable(self, work: float) -> float:
        """Finest cells, as a factor, that make no more ``work``; 0 if none does."""
        return next((finer for finer in _COARSER if self.work(finer) <= work), 0.0)


def extrapolated(larger: Array, smaller: Array, ratio: float) -> Array:
    """Of transfers by larger and smaller cells, what cells of no size would give (Richardson)."""
    return smaller + (smaller - larger) / (ratio**2 - 1)


def transfer(
    light: Light,
    amplitudes: Array,
    *,
    finer: float = 1.0,
    times: int = 1,
    only: tuple[int, int] | None = None,
) -> Array:
    """Transfers of masks (masks, scene pixels, embedding pixels); ``only`` one scene pixel.

    Relative to the irradiance at the mask's middle of a pixel on the axis, times their number.
    """
    y, x = light.y, light.x
    cells_y, cells_x = light.cells(y, finer, times), light.cells(x, finer, times)
    open_y, open_x = _openings(y, cells_y), _openings(x, cells_x)
    cell_y, cell_x = y.pitch / y.parts / cells_y, x.pitch / x.parts / cells_x
    masks = np.einsum("nr,bcrk,mk->bcnm", open_y, amplitudes, open_x)
    at_y, at_x = _positions(y, cell_y), _positions(x, cell_x)
    seen_y = _axis(math.ceil(light.seen(y) / cell_y) + 1, cell_y)
    seen_x = _axis(math.ceil(light.seen(x) / cell_x) + 1, cell_x)
    picked = (
        [only]
        if only
        else [(row, column) for row in range(y.scene_pixels) for column in range(x.scene_pixels)]
    )
    found = np.zeros((len(amplitudes), len(picked), y.pixels * x.pixels))
    for index, (row, column) in enumerate(picked):
        for point, beam in itertools.product(_sources(light, row, column), light.beams):
            flux = _flux(
                light, beam, masks[:, beam.channel], point, ((at_y, at_x), (seen_y, seen_x))
            )
            binned = _binned(light, beam, flux, (seen_y, seen_x))
            share = beam.share if light.shares is None else beam.share * light.shares[beam.channel]
            share = share * _evened(light, point, beam.scene_distance)
            found[:, index] += (share * binned).reshape(len(amplitudes), -1)
    return found / (y.scene_pixels * x.scene_pixels * light.sources**2)


def _sources(light: Light, row: int, column: int) -> list[tuple[float, float]]:
    y, x = (
        axis.scene_shift
        + (at - (axis.scene_pixels - 1) / 2) * axis.scene_pixel
        + _axis(light.sources, axis.scene_pixel / light.sources)
        for axis, at in ((light.y, row), (light.x, column))
    )
    return [(float(down), float(across)) for down in y for across in x]


def _evened(light: Light, point: tuple[float, float], distance: float) -> float:
    """Mean brightness of the part of a scene pixel around a point, over the point's own."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    y, x = (
        (at + axis.scene_pixel / light.sources / 2 * nodes) / distance
        for at, axis in zip(point, (light.y, light.x), strict=True)
    )
    bright = (1 + y[:, None] ** 2 + x**2) ** -2.0
    here = (1 + (point[0] ** 2 + point[1] ** 2) / distance**2) ** -2
    return float(weights @ bright @ weights) / 4 / here


def _flux(
    light: Light,
    beam: Beam,
    masks: Array,
    point: tuple[float, float],
    planes: tuple[tuple[Array, Array], tuple[Array, Array]],
) -> Array:
    k = 2 * math.pi / beam.wavelength
    at, seen = planes
    # The mask's own frame: everything else is turned the other way.
    here = _turned(*point, -light.rotation)
    source = math.hypot(*here, beam.scene_distance)
    y, x = at[0][:, None], at[1]
    way = np.sqrt((y - here[0]) ** 2 + (x - here[1]) ** 2 + beam.scene_distance**2)
    tilt = -here[0] / source, -here[1] / source
    # Of the incident wave its plane part goes to the kernel, so that no cell sees much of a phase.
    rest = np.exp(1j * k * (way - source - tilt[0] * y - tilt[1] * x))
    lambert = np.sqrt(beam.scene_distance / way)
    wave = rest * lambert * beam.scene_distance / way
    rows, columns = len(at[0]) + len(seen[0]) - 1, len(at[1]) + len(seen[1]) - 1
    sizes = _fast(rows), _fast(columns)
    steps = seen[0][1] - seen[0][0], seen[1][1] - seen[1][0]  # a mask may be one cell
    dy = (seen[0][0] - at[0][-1] + steps[0] * np.arange(rows))[:, None]
    dx = seen[1][0] - at[1][-1] + steps[1] * np.arange(columns)
    far = np.sqrt(dy**2 + dx**2 + light.distance**2)
    turn = np.exp(1j * k * (far - light.distance - tilt[0] * dy - tilt[1] * dx))
    averaged = np.sinc(steps[0] * (dy / far - tilt[0]) / beam.wavelength)
    averaged = averaged * np.sinc(steps[1] * (dx / far - tilt[1]) / beam.wavelength)
    area = steps[0] * steps[1] / (2 * math.pi)
    green = turn * averaged * area / far**3
    cosine = light.distance
    kernel = green * cosine * (1 - 1j * k * far)
    # d/dz of z (1/R - ik) e^{ikR} / R^2
    slope = green * ((1 - 1j * k * far) + cosine**2 * (-3 + 3j * k * far + (k * far) ** 2) / far**2)
    spectra = [np.fft.fft2(part, sizes) for part in (kernel, slope)]
    flux = np.empty((len(masks), len(seen[0]), len(seen[1])))
    keep = np.s_[len(at[0]) - 1 : rows, len(at[1]) - 1 : columns]
    for index, mask in enumerate(masks):
        field_ = np.fft.fft2(mask * wave, sizes)
        value, derivative = (np.fft.ifft2(field_ * part)[keep] for part in spectra)
        flux[index] = (value.conj() * derivative).imag / k
    return flux


def _binned(light: Light, beam: Beam, flux: Array, seen: tuple[Array, Array]) -> Array:
    """Means over embedding pixels, blurred by a source's image: (masks, rows, columns)."""
    reduced = light.distance / beam.scene_distance / light.sources
    images = [axis.scene_pixel * reduced for axis in (light.y, light.x)]
    cells = [at[1] - at[0] for at in seen]
    if not light.rotation:
        rows, columns = (
            cell * _trapezoids(axis, image, _axis(axis.pixels, 1.0)[:, None], at, cell)
            for axis, image, at, cell in zip((light.y, light.x), images, seen, cells, strict=True)
        )
        spread: Array = np.einsum("pn,bnm,qm->bpq", rows, flux, columns, optimize=True)
        return spread
    turned = _turned(seen[0][:, None], seen[1][None], light.rotation)
    # A turned cell's shadow on an axis is about a box that is as wide, root mean square.
    cosine, sine = math.cos(light.rotation), math.sin(light.rotation)
    widths = [math.hypot(one * cosine, other * sine) for one, other in (cells, cells[::-1])]
    found = np.empty((len(flux), light.y.pixels, light.x.pixels))
    for p, middle_y in enumerate(_axis(light.y.pixels, 1.0)):
        along_y = cells[0] * _trapezoids(light.y, images[0], middle_y, turned[0], widths[0])
        for q, middle_x in enumerate(_axis(light.x.pixels, 1.0)):
            along_x = cells[1] * _trapezoids(light.x, images[1], middle_x, turned[1], widths[1])
            found[:, p, q] = (flux * along_y * along_x).sum((1, 2))
    return found


def _turned(y: Array | float, x: Array | float, angle: float) -> tuple[Array, Array]:
    cosine, sine = math.cos(angle), math.sin(angle)
    return y * cosine + x * sine, x * cosine - y * sine  # type: ignore[return-value]


def _trapezoids(axis: Axis, image: float, middle: Array | float, at: Array, width: float) -> Array:
    """Density of the mean over an embedding pixel's box, blurred by a box as long as ``image``.

    Its middle is in pixels from the sensor's.

    It is the mean over ``width``, and so exact for light that is even over so much.
    """
    away = at - middle * axis.sensor / axis.pixels
    side = axis.fill * axis.sensor / axis.pixels
    outer, inner = (side + image) / 2, abs(side - image) / 2
    found = np.zeros_like(away)
    for end, (sign, corner) in itertools.product(
        (1, -1), ((1, -outer), (-1, -inner), (-1, inner), (1, outer))
    ):
        found += end * sign * np.clip(away + end * width / 2 - corner, 0, None) ** 2 / 2
    return found / (side * image * width)


def _openings(axis: Axis, cells: int) -> Array:
    first = (axis.parts - axis.open_parts) * cells // 2
    one = np.zeros(axis.parts * cells)
    one[first : first + axis.open_parts * cells] = 1
    openings: Array = np.kron(np.eye(axis.apertures), one[:, None]).astype(np.float64)
    return openings


def _positions(axis: Axis, cell: float) -> Array:
    cells = round(axis.pitch / axis.parts / cell)
    # Where the closed part is odd, openings are half a cell too low among their cells.
    late = (axis.parts - axis.open_parts) * cells % 2 * cell / 2
    return _axis(axis.apertures * axis.parts * cells, cell) + axis.shift + late


def _axis(count: int, step: float) -> Array:
    positions: Array = (np.arange(count, dtype=np.float64) - (count - 1) / 2) * step
    return positions


def _fast(least: int) -> int:
    """The smallest 2^a 3^b 5^c that is not smaller."""
    best = 1 << max(0, least - 1).bit_length()
    for fives in (1, 5, 25):
        for threes in (1, 3, 9, 27):
            odd = fives * threes
            size = odd << max(0, math.ceil(math.log2(max(1, least / odd))))
            if size >= least:
                best = min(best, size)
    return best
