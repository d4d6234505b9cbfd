"""Masks of many kinds that a reader learns behind; none of them is a mask in question."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Values = npt.NDArray[Any]
Draw = Callable[[tuple[int, int], np.random.Generator], Values]
"""Draw of a mask's weights of a shape."""


def other_mask(shape: tuple[int, int], random: np.random.Generator) -> Values:
    """Return a mask of a kind drawn at random, float32 of ``shape``.

    Kinds are uniform and sparse weights, open and closed sub-pixels, clusters, stripes and holes,
    as fits learn them, in dark, even and random grounds.
    """
    kind = random.random()
    uniform = random.random(shape, np.float32)
    if kind < 0.3:
        return uniform
    if kind < 0.4:
        return uniform ** np.float32(random.uniform(2, 12))
    if kind < 0.5:
        return (uniform < 10 ** random.uniform(-1.6, -0.3)).astype(np.float32)
    if kind < 0.6:
        return _clusters(shape, random)
    if kind < 0.65:
        return _stripes(shape, random)
    ground = random.choice([0.0, random.uniform(0, 0.5)])
    dark = np.float32(ground) * (uniform if random.random() < 0.5 else np.ones_like(uniform))
    return _holes(dark, int(10 ** random.uniform(0, 2.3)), random)


def _holes(mask: Values, count: int, random: np.random.Generator) -> Values:
    """Open ``count`` pixels of three sub-pixels, some of them half."""
    rows, columns = mask.shape
    least = random.choice([1.0, 0.3])
    for _ in range(count):
        top, column = random.integers(max(1, rows - 2)), random.integers(columns)
        mask[top : top + 3, column] = random.uniform(least, 1)
    return mask


def _clusters(shape: tuple[int, int], random: np.random.Generator) -> Values:
    """Sub-pixels that are open where a smooth random field is high."""
    field = random.standard_normal(shape)
    wide = random.uniform(1, 6)
    for axis, sigma in enumerate((wide, wide / 3)):
        places = np.arange(shape[axis])
        kernel = np.exp(-(((places[:, None] - places) / sigma) ** 2) / 2)
        field = np.moveaxis(np.tensordot(kernel, field, (1, axis)), 0, axis)
    return (field > np.quantile(field, random.uniform(0.4, 0.8))).astype(np.float32)


def _stripes(shape: tuple[int, int], random: np.random.Generator) -> Values:
    """Rows or columns that are open at random."""
    along = (shape[0], 1) if random.random() < 0.5 else (1, shape[1])
    return np.broadcast_to(random.random(along) < 0.5, shape).astype(np.float32)
