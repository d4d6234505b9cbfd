"""Binning of a raw frame to an embedding: exact area averages, in whole numbers to the last step.

Boxes need not hold whole pixels: one that is cut by an edge counts to both boxes, by its area.
"""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import pairwise

import numpy as np
import numpy.typing as npt

Raw = npt.NDArray[np.uint16]
"""A raw frame, shape (rows, columns)."""


class Binning:
    """From raw frames of one shape to averages over equal boxes.

    Args:
        raw: shape (rows, columns) of the frames.
        embedding: shape (rows, columns) of the boxes.

    Raises:
        ValueError: more boxes than pixels.
    """

    def __init__(self, raw: tuple[int, int], embedding: tuple[int, int]) -> None:
        self._raw = raw
        self._row_cuts, self._row_shares = _axis(raw[0], embedding[0])
        self._column_cuts, self._column_shares = _axis(raw[1], embedding[1])

    def __call__(self, raw: Raw) -> npt.NDArray[np.float64]:
        """Return the mean of every box, shape of the embedding.

        Raises:
            ValueError: a frame of another shape.
        """
        if raw.shape != self._raw:
            raise ValueError(f"a raw frame of shape {raw.shape} is not valid: use {self._raw}")
        # 32 bits hold the sum of 65,537 pixels of 16 bits: more rows than any sensor has.
        strips = np.stack(
            [raw[first:last].sum(0, dtype=np.uint32) for first, last in pairwise(self._row_cuts)]
        )
        sums = np.add.reduceat(strips, self._column_cuts[:-1], axis=1, dtype=np.uint64)
        strips.fill(0)
        return self._row_shares @ sums.astype(np.float64) @ self._column_shares.T


def _axis(pixels: int, boxes: int) -> tuple[list[int], npt.NDArray[np.float64]]:
    """Where to cut an axis, and what share each piece has in the mean of each box."""
    if not 1 <= boxes <= pixels:
        raise ValueError(f"{boxes} boxes are not valid: use 1 to {pixels}, the number of pixels")
    edges = [Fraction(box * pixels, boxes) for box in range(boxes + 1)]
    cuts = sorted({whole for edge in edges for whole in (math.floor(edge), math.ceil(edge))})
    shares = np.zeros((boxes, len(cuts) - 1))
    for box, (low, high) in enumerate(pairwise(edges)):
        for piece, (first, last) in enumerate(pairwise(cuts)):
            inside = min(high, Fraction(last)) - max(low, Fraction(first))
            if inside > 0:
                shares[box, piece] = float(inside / ((last - first) * (high - low)))
    return cuts, shares
