"""Sightings: few events of many captures, fused into a belief, and a short history."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from veilcam_server.masks.source import Evidence
from veilcam_server.watch.belief import FRESH, PAIRS, Dynamics, Probabilities, Thresholds, fuse

GONE = 0.05
"""Probability below which a thing is reported as gone."""
_HINT = 0.2
"""Probability from which the time of a thing's first capture is remembered."""


@dataclass(frozen=True, slots=True)
class Sight:
    """Thing in front of the camera, now or in the past."""

    label: str
    confidence: float
    """Highest probability of the thing."""
    since: float
    """Time of its first capture, on the watch's clock [s]."""
    until: float | None = None
    """Time of its end [s]; None while it is there."""


@dataclass(frozen=True, slots=True)
class Change:
    """Arrival or departure of a thing."""

    kind: Literal["seen", "gone"]
    label: str
    confidence: float | None
    """Probability of the arrival or the departure; None where the camera stopped looking."""
    duration: float
    """Time since its first capture [s]."""


@dataclass(frozen=True, slots=True)
class Leader:
    """Most probable state."""

    label: str | None
    """Label of the class; None for nothing known."""
    confidence: float
    since: float
    """Time of the first capture of this state, on the watch's clock [s]."""
    looks: int
    """Captures since then, that one included."""


@dataclass(frozen=True, slots=True)
class _Hint:
    """First capture of a state, and the number of captures since."""

    since: float
    looks: int


class Sightings:
    """Changes and history of a belief: one change when a thing comes, and one when it goes.

    Args:
        length: number of sights in the history.
        seen: probability from which a thing is reported as seen.
    """

    def __init__(self, length: int, seen: float) -> None:
        self.leader: Leader | None = None
        """Most probable state; None where the camera does not look."""
        self._there: Sight | None = None
        self._hints: dict[str | None, _Hint] = {}
        self._past: deque[Sight] = deque(maxlen=length)
        self._length, self._seen = length, seen

    @property
    def history(self) -> tuple[Sight, ...]:
        """Last sights, newest first."""
        now = () if self._there is None else (self._there,)
        return (*now, *reversed(self._past))[: self._length]

    def follow(self, told: Probabilities, labels: Sequence[str], at: float) -> list[Change]:
        """Follow a belief after a capture, and return its changes.

        Args:
            told: probabilities of nothing and of every class.
            labels: labels of the classes.
            at: time of the capture [s].
        """
        names = (None, *labels)
        self._hints = {
            name: _Hint(known.since, known.looks + 1)
            if (known := self._hints.get(name)) is not None
            else _Hint(at, 1)
            for name, share in zip(names, told, strict=True)
            if share >= _HINT or share == np.max(told)
        }
        best = int(np.argmax(told))
        label, confidence = names[best], float(told[best])
        hint = self._hints[label]
        self.leader = Leader(label, confidence, hint.since, hint.looks)
        changes = []
        there = self._there
        if there is not None:
            left = 1 - float(told[1 + labels.index(there.label)])
            if left >= 1 - GONE:
                changes.append(self._end(there, hint.since, left))
            else:
                self._there = replace(there, confidence=max(there.confidence, 1 - left))
        if self._there is None and label is not None and confidence >= self._seen:
            self._there = Sight(label, confidence, hint.since)
            changes.append(Change("seen", label, confidence, at - hint.since))
        return changes

    def stop(self, at: float) -> list[Change]:
        """Forget the belief, as the camera stops looking, and return the changes."""
        self.leader, self._hints, there = None, {}, self._there
        return [] if there is None else [self._end(there, at, None)]

    def _end(self, there: Sight, at: float, confidence: float | None) -> Change:
        self._there, until = None, max(at, there.since)
        self._past.append(replace(there, until=until))
        return Change("gone", there.label, confidence, until - there.since)


class Fusion:
    """Fusion of captures, one after the other, into a belief and its changes.

    Args:
        thresholds: thresholds of captures of a thing, and of its report.
        dynamics: rates at which things come and go.
        length: number of sights in the history.
    """

    def __init__(self, thresholds: Thresholds, dynamics: Dynamics, length: int) -> None:
        self._thresholds, self._dynamics = thresholds, dynamics
        self._sightings = Sightings(length, thresholds.seen)
        self._belief: Probabilities | None = None
        self._labels: tuple[str, ...] = ()
        self._last = 0.0

    @property
    def leader(self) -> Leader | None:
        """Most probable state; None where the camera does not look."""
        return self._sightings.leader

    @property
    def history(self) -> tuple[Sight, ...]:
        """Last sights, newest first."""
        return self._sightings.history

    def take(self, evidence: Evidence, at: float) -> list[Change]:
        """Fuse the evidence of a capture, and return the changes.

        Args:
            evidence: evidence of the capture.
            at: time of the capture, in order [s].
        """
        changes = self.stop() if evidence.labels != self._labels else []
        self._labels = evidence.labels
        if self._belief is None:
            prior = self._dynamics.prior(len(self._labels))
        else:
            prior = self._dynamics.predict(self._belief, max(0.0, at - self._last))
        sensing = PAIRS if evidence.novelty is None else FRESH
        admitted = self._thresholds.admits(evidence)
        self._belief = fuse(prior, sensing.likelihood(evidence.logits, admitted=admitted))
        self._last = at
        return changes + self._sightings.follow(sensing.told(self._belief), self._labels, at)

    def stop(self) -> list[Change]:
        """Forget the belief, as the camera stops looking, and return the changes."""
        self._belief = None
        return self._sightings.stop(self._last)
