"""Fusion of captures, one after the other, into a belief and its changes."""

from __future__ import annotations

from veilcam_server.masks.source import Evidence
from veilcam_server.watch.admission import Admission
from veilcam_server.watch.belief import FRESH, PAIRS, Dynamics, Probabilities, fuse
from veilcam_server.watch.sightings import Change, Leader, Sight, Sightings


class Fusion:
    """A belief and what was seen; labels alone are remembered.

    Args:
        admission: test of a capture: does it look like one of a thing.
        dynamics: rates at which things come and go.
        length: sights that are remembered.
    """

    def __init__(self, admission: Admission, dynamics: Dynamics, length: int) -> None:
        self._admission, self._dynamics = admission, dynamics
        self._sightings = Sightings(length)
        self._belief: Probabilities | None = None
        self._labels: tuple[str, ...] = ()
        self._last = 0.0

    @property
    def leader(self) -> Leader | None:
        """Most probable state; None: nobody looks, so nothing is believed."""
        return self._sightings.leader

    @property
    def history(self) -> tuple[Sight, ...]:
        """Sightings of the past, newest first."""
        return self._sightings.history

    def take(self, evidence: Evidence, at: float) -> list[Change]:
        """Fuse what a capture tells, and return what changed.

        Args:
            evidence: evidence of the capture.
            at: time of the capture, not before the one before [s].
        """
        changes = self.stop() if evidence.labels != self._labels else []
        self._labels = evidence.labels
        if self._belief is None:
            prior = self._dynamics.prior(len(self._labels))
        else:
            prior = self._dynamics.predict(self._belief, max(0.0, at - self._last))
        sensing = PAIRS if evidence.novelty is None else FRESH
        admitted = self._admission.admits(evidence)
        self._belief = fuse(prior, sensing.likelihood(evidence.logits, admitted=admitted))
        self._last = at
        return changes + self._sightings.follow(sensing.told(self._belief), self._labels, at)

    def stop(self) -> list[Change]:
        """Believe nothing any more, as nobody looks; return what changed."""
        self._belief = None
        return self._sightings.stop(self._last)
