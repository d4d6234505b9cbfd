"""Bayes filter of what is in front of a camera: one of its classes, or nothing that it knows.

A hidden Markov model in continuous time. State 0 is nothing, 1 to K are what the scene reads as.

    dp_0/dt = b sum_k p_k - a p_0,
    dp_k/dt = a/K p_0 - (b + c) p_k + c/(K-1) sum_(j != k) p_j                  (prediction)
    p_x <- p_x L_x / sum_y p_y L_y                                              (Bayes' rule)

A capture tells whether it looks like a thing at all (``admitted``), and the classifier's logits z:

    L_0 = f,      L_k = (1 - m) K softmax(z / T)_k        where it was admitted,
    L_0 = 1 - f,  L_k = m                                 where it was not.

A classifier gives p(k | capture, thing); over a prior of 1/K that is K softmax, whose mean over the
classes is 1. So whether there is a thing is told by the admission alone, and which by the logits.

Captures of one scene are not independent: they share the scene. Both of what that does is in the
model. A scene that is hard is hard behind every mask: T is larger than the temperature that makes
the scores of one capture honest, and makes those of a product honest. And a scene may read as
another class for as long as it stays, which no capture more puts right: with probability e, so that
what is told of class k is

    P(k) = (1 - e) p_k + e/(K-1) sum_(j != k) p_j.

No input, no output, no clock: docs/watch.md has where the numbers come from.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Probabilities: TypeAlias = npt.NDArray[np.float64]
"""Of nothing and of every class, (1 + classes,): they sum to 1."""

_LEAST = 1e-12
"""Probability of what is all but impossible."""


@dataclass(frozen=True, slots=True)
class Dynamics:
    """Rates at which things come and go [1/s]; all greater than zero.

    Raises:
        ValueError: a rate that cannot be.
    """

    arrival: float = 0.1
    """a: of anything, where there is nothing."""
    departure: float = 0.2
    """b: of what is there."""
    exchange: float = 0.05
    """c: of what is there for something else, between two captures."""

    def __post_init__(self) -> None:
        for name in ("arrival", "departure", "exchange"):
            rate = getattr(self, name)
            if not (math.isfinite(rate) and rate > 0):
                raise ValueError(f"{name} = {rate} /s is not valid: use a number > 0")

    def prior(self, classes: int) -> Probabilities:
        """Belief after a long time without a look."""
        something = self.arrival / (self.arrival + self.departure)
        return np.array([1 - something] + classes * [something / classes])

    def predict(self, belief: Probabilities, seconds: float) -> Probabilities:
        """Return the belief after some time without a look, in closed form.

        Args:
            belief: belief at the start.
            seconds: since then [s]; 0 or more.
        """
        classes = len(belief) - 1
        mixing = self.departure + self.exchange * classes / max(1, classes - 1)
        settled = self.arrival / (self.arrival + self.departure)
        before = belief[1:].sum()
        something = settled + (before - settled) * math.exp(
            -(self.arrival + self.departure) * seconds
        )
        apart = (belief[1:] - before / classes) * math.exp(-mixing * seconds)
        later = np.concatenate([[1 - something], something / classes + apart])
        # Rounding must not make anything impossible: Bayes' rule would never believe it again.
        kept: Probabilities = np.maximum(later, _LEAST)
        return kept


@dataclass(frozen=True, slots=True)
class Sensing:
    """Evidence of one capture; docs/watch.md says how each number was measured.

    Raises:
        ValueError: a number that cannot be.
    """

    temperature: float
    """T: divides logits."""
    missed: float = 0.01
    """m: that a capture of a thing looks like one of nothing."""
    mistaken: float = 0.05
    """f: that a capture of nothing it knows looks like one of a thing."""
    misread: float = 0.003
    """e: that a scene reads as another class behind whatever mask."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.temperature) and self.temperature > 0):
            raise ValueError(f"temperature = {self.temperature} is not valid: use a number > 0")
        for name in ("missed", "mistaken", "misread"):
            share = getattr(self, name)
            if not 0 < share < 0.5:
                raise ValueError(f"{name} = {share} is not valid: use a number between 0 and 0.5")

    def likelihood(self, logits: Sequence[float], *, admitted: bool) -> Probabilities:
        """L, (1 + classes,); finite, and not all zero.

        Args:
            logits: the classifier's, one for each class.
            admitted: True where the capture looks like one of a thing.
        """
        classes = len(logits)
        if not admitted:
            return np.array([1 - self.mistaken] + classes * [self.missed])
        scaled = np.asarray(logits, np.float64) / self.temperature
        scores = np.exp(scaled - np.max(scaled))
        scores *= (1 - self.missed) * classes / scores.sum()
        return np.concatenate([[self.mistaken], scores])

    def told(self, belief: Probabilities) -> Probabilities:
        """P: what may be said of a belief in what the scene reads as."""
        things = belief[1:]
        if len(things) == 1:
            return belief
        others = (things.sum() - things) / (len(things) - 1)
        return np.concatenate([belief[:1], (1 - self.misread) * things + self.misread * others])


FRESH = Sensing(temperature=1.25, misread=0.003)
"""For the classifier of all masks, whose bundle comes along."""
PAIRS = Sensing(temperature=2.5, misread=0.01)
"""For classifiers of one mask each, whose bundle comes along."""


def fuse(prior: Probabilities, likelihood: Probabilities) -> Probabilities:
    """Bayes' rule."""
    product = prior * likelihood
    belief: Probabilities = product / product.sum()
    return belief
