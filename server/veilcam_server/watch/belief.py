"""Bayes filter of the scene: one of the classes, or nothing known.

It is a hidden Markov model in continuous time. State 0 is nothing, states 1 to K are the classes.

    dp_0/dt = b sum_k p_k - a p_0,
    dp_k/dt = a/K p_0 - (b + c) p_k + c/(K-1) sum_(j != k) p_j                  (prediction)
    p_x <- p_x L_x / sum_y p_y L_y                                              (Bayes' rule)

The evidence of a capture is its logits z, and whether it passes the thresholds (``admitted``):

    L_0 = f,      L_k = (1 - m) K softmax(z / T)_k        where it was admitted,
    L_0 = 1 - f,  L_k = m                                 where it was not.

A classifier gives p(k | capture, thing). Over a prior of 1/K that is K softmax, whose mean over the
classes is 1. So the thresholds alone decide whether there is a thing, and the logits decide which.

Captures of one scene are not independent. The model has two terms for that. A hard scene is hard
behind every mask: T is the temperature of calibrated scores of a product of captures, larger than
that of one capture. And with probability e a scene reads as another class as long as it stays:

    P(k) = (1 - e) p_k + e/(K-1) sum_(j != k) p_j.

docs/watch.md has the sources of all numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from veilcam_client.wire.calibration import CalibrationRecord
from veilcam_server.masks.source import Evidence

_DEVIATIONS = 10
"""Least light, in standard uncertainties of the black level."""
_TRANSMITTANCE = 1 / 3
"""Mean transmittance of a mask of uniformly distributed weights."""


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Thresholds of captures of a known thing, and of its report.

    The defaults are those of the simulated camera; docs/watch.md has their measurements.
    """

    least_light: float = 0.002
    """Least :attr:`Evidence.light`."""
    most_novelty: float = 7.0
    """Largest :attr:`Evidence.novelty`, which a bundle without scene statistics does not have."""
    seen: float = 0.6
    """Probability from which a thing is reported as seen."""

    def admits(self, evidence: Evidence) -> bool:
        """Return whether a capture looks like one of a thing."""
        familiar = evidence.novelty is None or evidence.novelty <= self.most_novelty
        return familiar and evidence.light >= self.least_light

    def calibrated(self, record: CalibrationRecord) -> Thresholds:
        """Return the thresholds of a camera with a measured black level.

        Args:
            record: record of its calibration.
        """
        unsure = record.black_level.uncertainty / record.gain.value / _TRANSMITTANCE
        return replace(self, least_light=max(self.least_light, _DEVIATIONS * unsure))


Probabilities: TypeAlias = npt.NDArray[np.float64]
"""Probabilities of nothing and of every class, (1 + classes,); their sum is 1."""

_LEAST = 1e-12
"""Least probability of a state."""


@dataclass(frozen=True, slots=True)
class Dynamics:
    """Rates at which things come and go [1/s]; all greater than zero."""

    arrival: float = 0.1
    """Rate a, from nothing to anything."""
    departure: float = 0.2
    """Rate b, from a thing to nothing."""
    exchange: float = 0.05
    """Rate c, from a thing to another thing."""

    def prior(self, classes: int) -> Probabilities:
        """Return the belief after a long time without a capture."""
        something = self.arrival / (self.arrival + self.departure)
        return np.array([1 - something] + classes * [something / classes])

    def predict(self, belief: Probabilities, seconds: float) -> Probabilities:
        """Return the belief after some time without a capture, in closed form.

        Args:
            belief: belief at the start.
            seconds: time since then [s]; 0 or more.
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
        # A probability that is rounded to zero would stay zero by Bayes' rule.
        kept: Probabilities = np.maximum(later, _LEAST)
        return kept


@dataclass(frozen=True, slots=True)
class Sensing:
    """Model of the evidence of one capture; docs/watch.md has the measurement of each number."""

    temperature: float
    """Temperature T, which divides logits."""
    missed: float = 0.01
    """Probability m that a capture of a thing looks like one of nothing."""
    mistaken: float = 0.05
    """Probability f that a capture of nothing known looks like one of a thing."""
    misread: float = 0.003
    """Probability e that a scene reads as another class behind every mask."""

    def likelihood(self, logits: Sequence[float], *, admitted: bool) -> Probabilities:
        """Return the likelihood L, (1 + classes,); finite, and not all zero.

        Args:
            logits: logits of the classifier, one for each class.
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
        """Return the probabilities P of the scene, for a belief in its reading."""
        things = belief[1:]
        if len(things) == 1:
            return belief
        others = (things.sum() - things) / (len(things) - 1)
        return np.concatenate([belief[:1], (1 - self.misread) * things + self.misread * others])


FRESH = Sensing(temperature=1.25, misread=0.003)
"""Evidence of the demo's classifier for all masks."""
PAIRS = Sensing(temperature=2.5, misread=0.01)
"""Evidence of the demo's classifiers for one mask each."""


def fuse(prior: Probabilities, likelihood: Probabilities) -> Probabilities:
    """Return the posterior by Bayes' rule."""
    product = prior * likelihood
    belief: Probabilities = product / product.sum()
    return belief
