"""Intervals of what attackers gain over knowing nothing, and the error that all rows share.

A row *holds* where its gain is proven to be at most its bar: the one-sided test of "the gain is
above the bar" rejects. Over all rows Holm's procedure (1979) keeps the chance that any of them
holds wrongly at ``ALPHA``; it needs no assumption on how rows depend on each other, and they do:
they are attacks on the same masks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.stats import norm, rankdata

ALPHA = 0.01
"""Chance that any row is said to hold and does not."""

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Gain:
    """Gain of an attacker, with its interval.

    Attributes:
        value: gain in this sample, at least; 0 or below: nothing.
        error: standard error of ``value``.
        bar: most that is taken.
        count: captures, or pairs of them, that were attacked.
        shown: the statistic itself: an accuracy [%] or an area under a curve.
    """

    value: float
    error: float
    bar: float
    count: int
    shown: float

    def upper(self, alpha: float) -> float:
        """Upper end of the one-sided interval of level ``1 - alpha``."""
        return self.value + float(norm.isf(alpha)) * self.error

    @property
    def doubt(self) -> float:
        """p-value of "the gain is above the bar"."""
        if self.error == 0:
            return float(self.value > self.bar)
        return float(norm.cdf((self.value - self.bar) / self.error))


@dataclass(frozen=True)
class Verdict:
    """Verdict about one row beside all others.

    Attributes:
        upper: upper end of the one-sided interval at the level of Holm's procedure.
        holds: True where that is at most the bar, here and in all rows that are surer.
    """

    gain: Gain
    upper: float
    holds: bool


def accuracy_gain(hits: npt.NDArray[np.bool_], classes: int, bar: float = 1.0) -> Gain:
    """Advantage over the best constant guess, in points.

    Classes are drawn with equal chances, so that no constant guess is better than ``1 / classes``
    and that number is known, not estimated. Captures of one mask depend on each other: the
    standard error is that of the means of masks. The interval is the normal one; it is of thousands
    of masks.

    Args:
        hits: True where a capture's class was guessed, (masks, captures of each).
        classes: number of classes.
        bar: most that is taken, in points.
    """
    means = hits.mean(axis=1)
    share = 100 * float(means.mean())
    error = 100 * float(means.std(ddof=1)) / math.sqrt(len(means))
    return Gain(share - 100 / classes, error, bar, hits.size, share)


def area(scores: Floats, positive: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Area under the curve of a score, and its standard error (DeLong et al. 1988)."""
    high, low = scores[positive], scores[~positive]
    if min(len(high), len(low)) < 2:
        raise ValueError("an area needs two of either kind")
    # Ranks among all, less ranks among one's own kind: how many of the other kind are below.
    ranks = rankdata(np.concatenate([high, low]))
    above = (ranks[: len(high)] - rankdata(high)) / len(low)
    below = 1 - (ranks[len(high) :] - rankdata(low)) / len(high)
    variance = above.var(ddof=1) / len(high) + below.var(ddof=1) / len(low)
    return float(above.mean()), math.sqrt(float(variance))


def area_gain(
    scores: Floats, positive: npt.NDArray[np.bool_], folds: npt.NDArray[np.int64]
) -> Gain:
    """``|AUC - 1/2|`` over folds, of which each has a model of its own.

    Scores of two models are not compared: the area is the mean of the folds' areas.
    """
    parts = [area(scores[folds == each], positive[folds == each]) for each in np.unique(folds)]
    mean = float(np.mean([value for value, _ in parts]))
    error = math.sqrt(sum(each**2 for _, each in parts)) / len(parts)
    return _of_area(mean, error, len(scores))


def linkage_gain(blocks: Floats) -> Gain:
    """``|AUC - 1/2|`` of "the same scene" against "another one", of blocks that share nothing.

    Args:
        blocks: scores (blocks, pairs, pairs): of one's first capture with another's second; on the
            diagonal both saw the same scene. The standard error is that of the blocks' areas.
    """
    pairs = blocks.shape[1]
    same = np.eye(pairs, dtype=bool)
    areas = np.array([area(block.ravel(), same.ravel())[0] for block in blocks])
    error = float(areas.std(ddof=1)) / math.sqrt(len(areas))
    return _of_area(float(areas.mean()), error, len(blocks) * pairs)


def _of_area(value: float, error: float, count: int) -> Gain:
    return Gain(abs(value - 0.5), error, 0.02, count, value)


def holm(gains: Mapping[str, Gain], alpha: float = ALPHA) -> dict[str, Verdict]:
    """Verdicts of all rows together, the surest first."""
    order: Sequence[str] = sorted(gains, key=lambda name: gains[name].doubt)
    verdicts: dict[str, Verdict] = {}
    level, holding = alpha / max(1, len(order)), True
    for place, name in enumerate(order):
        if holding:
            level = alpha / (len(order) - place)
        holding = holding and gains[name].doubt <= level
        verdicts[name] = Verdict(gains[name], gains[name].upper(level), holding)
    return verdicts
