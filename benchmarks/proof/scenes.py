"""Scenes drawn wide: what is in front of a camera, and what surrounds it.

A scene is the light of a field, (channels, y, x), 1 where it is white. Objects lie on black and
come in pairs: the second of two is the first one, moved. Surroundings fill the field.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from benchmarks.proof.light import CHANNELS, Array, Singles

from veilcam_server.demo_data import Digits

OBSERVED = (0.25, 0.5, 0.25)
"""Shares that a tint keeps the sum of."""

FARTHEST = 4
"""Pixels of the field that an object moves by along an axis while a frame is read in 23 ms: 60
mrad, 1 m/s in 0.4 m."""

Chance = np.random.Generator
Draw = Callable[[int, Chance], Array]


def draw_objects(
    pairs: int, pixels: int, *, square: int, digits: Digits, tint: float, chance: Chance
) -> Singles:
    """Objects and where they went: (2 x pairs, channels, pixels, pixels).

    Args:
        pairs: how many objects.
        pixels: of the field, on each side.
        square: pixels of the field across the task's square.
        digits: to draw from.
        tint: standard deviation of a channel's light, as a logarithm.
        chance: source of the random numbers.
    """
    kinds: tuple[Draw, ...] = (
        *[partial(_digit, digits, square)] * 4,
        _points,
        partial(_box, square),
        partial(_patch, square),
    )
    scenes = []
    for _ in range(pairs):
        still = kinds[chance.integers(len(kinds))](pixels, chance)
        moved = _moved(still, *chance.integers(-FARTHEST, FARTHEST + 1, 2))
        colour = _colour(tint, chance)
        scenes += [colour * still, colour * moved]
    return np.array(scenes, np.float32)


def draw_surroundings(count: int, pixels: int, tint: float, chance: Chance) -> Singles:
    """Surroundings: (count, channels, pixels, pixels)."""
    kinds: tuple[Draw, ...] = (
        *[power_law] * 3,
        plain,
        gradient,
        _stripes,
        _checks,
        _boxes,
        half_lit,
        _points,
    )
    return np.array(
        [
            _colour(tint, chance) * kinds[chance.integers(len(kinds))](pixels, chance)
            for _ in range(count)
        ],
        np.float32,
    )


def every_kind(digits: Digits, square: int) -> dict[str, Draw]:
    """What scenes are drawn from, by name.

    Args:
        digits: to draw from.
        square: pixels of the field across the task's square.
    """
    return {
        "digit": partial(_digit, digits, square),
        "picture in a square": partial(_patch, square),
        "white rectangle": partial(_box, square),
        "lamps": _points,
        "natural": power_law,
        "leaves": _boxes,
        "edge": half_lit,
        "checks": _checks,
        "stripes": _stripes,
        "gradient": gradient,
        "wall": plain,
    }


def _colour(tint: float, chance: Chance) -> Array:
    colour = np.exp(tint * chance.standard_normal(len(CHANNELS)))
    shares: Array = (colour / np.dot(colour, OBSERVED))[:, None, None]
    return shares


def plain(pixels: int, chance: Chance) -> Array:  # noqa: ARG001 - nothing to draw
    """A wall."""
    return np.ones((pixels, pixels))


def gradient(pixels: int, chance: Chance) -> Array:
    """Light that falls off to one side."""
    y, x = _places(pixels)
    angle = chance.uniform(0, 2 * np.pi)
    return _to_one(np.cos(angle) * y + np.sin(angle) * x)


def half_lit(pixels: int, chance: Chance) -> Array:
    """An edge between light and dark: a window."""
    y, x = _places(pixels)
    angle = chance.uniform(0, 2 * np.pi)
    edge = chance.uniform(-0.5, 0.5)
    field: Array = np.where(np.cos(angle) * y + np.sin(angle) * x > edge, 1.0, 0.0)
    return field


def power_law(pixels: int, chance: Chance) -> Array:
    """A random field whose amplitudes fall as a power of the frequency, as those of nature do."""
    y, x = np.fft.fftfreq(pixels)[:, None], np.fft.rfftfreq(pixels)
    frequency = np.maximum(np.hypot(y, x), 1 / pixels)
    phases = chance.standard_normal((2, *frequency.shape))
    spectrum = (phases[0] + 1j * phases[1]) * frequency ** -chance.uniform(0.7, 1.6)
    return _to_one(np.fft.irfft2(spectrum, (pixels, pixels)))


def _stripes(pixels: int, chance: Chance) -> Array:
    y, x = _places(pixels)
    angle, cycles = chance.uniform(0, np.pi), chance.uniform(1, 20)
    if chance.random() < 0.4:  # along the panel's own lines
        angle = float(chance.choice([0, np.pi / 2]))
    wave = np.sin(np.pi * cycles * (np.cos(angle) * y + np.sin(angle) * x) + chance.uniform(0, 6))
    field: Array = 0.5 + 0.5 * (np.sign(wave) if chance.random() < 0.5 else wave)
    return field


def _checks(pixels: int, chance: Chance) -> Array:
    y, x = np.indices((pixels, pixels))
    side, (top, left) = chance.integers(2, 20), chance.integers(0, 20, 2)
    field: Array = ((y + top) // side + (x + left) // side) % 2 * 1.0
    return field


def _boxes(pixels: int, chance: Chance) -> Array:
    """Leaves of random sizes that cover each other."""
    field = np.full((pixels, pixels), chance.random())
    for _ in range(40):
        rows, columns = _span(pixels, chance), _span(pixels, chance)
        field[rows, columns] = chance.random()
    return field


def _span(pixels: int, chance: Chance) -> slice:
    start = int(chance.integers(pixels))
    return slice(start, start + 1 + int(pixels * 0.5 * chance.random() ** 2))


def _points(pixels: int, chance: Chance) -> Array:
    """One to five lamps, one pixel each, as bright as all of a white square."""
    field = np.zeros((pixels, pixels))
    for _ in range(chance.integers(1, 6)):
        y, x = chance.integers(pixels // 5, 4 * pixels // 5, 2)
        field[y, x] = 400 * chance.uniform(0.2, 1)
    return field


def _digit(digits: Digits, square: int, pixels: int, chance: Chance) -> Array:
    """A digit of any size, turned, somewhere near the middle."""
    image = digits.images[chance.integers(len(digits))] / 255
    y, x = np.indices((pixels, pixels)) - (pixels - 1) / 2
    y, x = y - chance.normal(0, square / 6), x - chance.normal(0, square / 6)
    angle, side = chance.normal(0, 0.3), square * np.exp(chance.normal(0, 0.4)) / 28
    down = (np.cos(angle) * y - np.sin(angle) * x) / side + 13.5
    right = (np.sin(angle) * y + np.cos(angle) * x) / side + 13.5
    return _sampled(image, down, right)


def _sampled(image: Array, down: Array, right: Array) -> Array:
    """Bilinear, black outside."""
    padded = np.pad(image, 1)
    down, right = (
        np.clip(place + 1, 0, side - 1.001)
        for place, side in zip((down, right), padded.shape, strict=True)
    )
    y, x = down.astype(np.intp), right.astype(np.intp)
    lower, later = down - y, right - x
    upper = padded[y, x] * (1 - later) + padded[y, x + 1] * later
    beneath = padded[y + 1, x] * (1 - later) + padded[y + 1, x + 1] * later
    result: Array = upper * (1 - lower) + beneath * lower
    return result


def _box(square: int, pixels: int, chance: Chance) -> Array:
    """An evenly lit object."""
    field = np.zeros((pixels, pixels))
    height, width = chance.integers(2, 2 * square, 2)
    top, left = (int(chance.integers(0, pixels - side)) for side in (height, width))
    field[top : top + height, left : left + width] = 1
    return field


def _patch(square: int, pixels: int, chance: Chance) -> Array:
    """A picture in a square."""
    field = np.zeros((pixels, pixels))
    top, left = chance.integers(0, pixels - square, 2)
    field[top : top + square, left : left + square] = power_law(square, chance)
    return field


def _moved(field: Array, down: int, right: int) -> Array:
    moved = np.roll(field, (down, right), (0, 1))
    for line, axis in ((down, 0), (right, 1)):
        gone = slice(0, line) if line >= 0 else slice(line, None)
        moved[(gone, slice(None)) if axis == 0 else (slice(None), gone)] = 0
    return moved


def _places(pixels: int) -> tuple[Array, Array]:
    places = np.linspace(-1, 1, pixels)
    return places[:, None], places[None, :]


def _to_one(field: Array) -> Array:
    field = field - np.min(field)
    shares: Array = field / max(float(np.max(field)), 1e-12)
    return shares
