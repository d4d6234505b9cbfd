"""Sightings: few events of many captures, as a belief changes, and a short history."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from veilcam_server.watch.belief import Probabilities

SEEN, GONE = 0.6, 0.05
"""Probabilities from which on a thing is said to be there, and to be there no longer."""
_HINT = 0.2
"""Probability from which on something is taken note of, to say later since when it was there."""


@dataclass(frozen=True, slots=True)
class Sight:
    """Something that was there."""

    label: str
    confidence: float
    """The highest while it was there."""
    since: float
    """Of the first capture that told of it, on the watch's clock [s]."""
    until: float | None = None
    """None: it is there still."""


@dataclass(frozen=True, slots=True)
class Change:
    """Something appeared, or went."""

    kind: Literal["seen", "gone"]
    label: str
    confidence: float | None
    """Probability that it is there, or that it is there no longer; None: nobody looks any more."""
    duration: float
    """How long it has been there [s]."""


@dataclass(frozen=True, slots=True)
class Leader:
    """Most probable state."""

    label: str | None
    """None: nothing that is known."""
    confidence: float
    since: float
    """Of the first capture that told of it, on the watch's clock [s]."""
    looks: int
    """Captures since, that one included."""


@dataclass(frozen=True, slots=True)
class _Hint:
    """Something that may be there."""

    since: float
    looks: int


class Sightings:
    """Follows a belief. A thing is told of once when it comes, and once when it goes.

    Args:
        length: sights that are remembered.
    """

    def __init__(self, length: int) -> None:
        self.leader: Leader | None = None
        """None: nothing is believed, as nobody looks."""
        self._there: Sight | None = None
        self._hints: dict[str | None, _Hint] = {}
        self._past: deque[Sight] = deque(maxlen=length)
        self._length = length

    @property
    def history(self) -> tuple[Sight, ...]:
        """The last ones, newest first."""
        now = () if self._there is None else (self._there,)
        return (*now, *reversed(self._past))[: self._length]

    def follow(self, told: Probabilities, labels: Sequence[str], at: float) -> list[Change]:
        """Take note of a belief after a capture, and return what changed.

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
        if self._there is None and label is not None and confidence >= SEEN:
            self._there = Sight(label, confidence, hint.since)
            changes.append(Change("seen", label, confidence, at - hint.since))
        return changes

    def stop(self, at: float) -> list[Change]:
        """Believe nothing any more, as nobody looks; return what was told of and is no longer."""
        self.leader, self._hints, there = None, {}, self._there
        return [] if there is None else [self._end(there, at, None)]

    def _end(self, there: Sight, at: float, confidence: float | None) -> Change:
        self._there, until = None, max(at, there.since)
        self._past.append(replace(there, until=until))
        return Change("gone", there.label, confidence, until - there.since)
