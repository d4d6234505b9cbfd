"""Proof of captures: which masks the panel may show, and what the last captures came to.

Every number that a test finds depends on the light of the scene: none of them leaves in the clear.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from statistics import fmean

import numpy as np
import numpy.typing as npt

from veilcam_client.wire.captures import ProofNote
from veilcam_client.wire.status import ProofMeans
from veilcam_optics.proof import Finding, MaskTest, Verdict
from veilcam_server.devices.base import Measurement

CAPTURES = 100
"""So many of the last captures are looked at together."""
DRIFTED = 0.5
"""Share of what is usual that a mask still leaves of its mark, below which a calibration is asked
for."""
OFTEN = 3
"""So many captures in a row do not show their masks, though the panel passes its self tests."""
_FIRST_PAUSE, _LONGEST_PAUSE = 10.0, 600.0
"""Before the panel is tested again then, doubled from one to the next [s]."""


class HeldTest:
    """The test of one mask, erased once nobody holds it any more. Any thread may let it go.

    Args:
        test: held once, by whoever makes this.
        mark: of the mask, if it is a stored one that may come again.
    """

    def __init__(self, test: MaskTest, mark: str = "") -> None:
        self.test, self._mark = test, mark
        self._holders, self._lock = 1, threading.Lock()

    def same_mask(self, other: HeldTest) -> bool:
        """Whether both are known to be of one mask."""
        return bool(self._mark) and self._mark == other._mark

    def hold(self) -> None:
        """Keep it from being erased until :meth:`let_go` is called as often."""
        with self._lock:
            self._holders += 1

    def let_go(self) -> None:
        """End one holding."""
        with self._lock:
            self._holders -= 1
            if not self._holders:
                self.test.erase()


class ShownMasks:
    """The mask that the panel was told last, and those that it may show all the same.

    Where a write was lost, that is the mask shown right before, or, unless a capture has seen that
    one, the last that a capture saw. One capture that sees the present mask rules them out, and
    their tests are let go. Called by one thread at a time.
    """

    def __init__(self) -> None:
        self._own: HeldTest | None = None
        self._before: tuple[HeldTest, ...] = ()
        """The one right before, and the last that was seen."""

    def show(self, test: HeldTest) -> None:
        """The panel was told another mask, or the same once more."""
        if test is self._own:
            return
        test.hold()
        told = () if self._own is None else (self._own, *self._before)
        candidates = (*told[:1], *told[1:][-1:])
        # A stored mask that comes again is no other one.
        self._before = tuple(each for each in candidates if not each.same_mask(test))
        self._own = test
        for each in told:
            if each not in self._before:
                each.let_go()

    def find(self, measurement: Measurement, clipped: npt.NDArray[np.bool_]) -> Finding:
        """What a capture says of the mask that the panel was told last.

        Raises:
            ValueError: it was told none.
        """
        if self._own is None:
            raise ValueError("no mask is shown")
        before = [each.test for each in self._before]
        finding = self._own.test.find(measurement, clipped, before)
        if finding.verdict == "seen":
            self._rule_out()
        return finding

    def forget(self) -> None:
        """Something else was shown than masks."""
        self._rule_out()
        if self._own is not None:
            self._own.let_go()
        self._own = None

    def _rule_out(self) -> None:
        before, self._before = self._before, ()
        for each in before:
            each.let_go()


class Brake:
    """Pauses of a camera whose captures do not show their masks time and again.

    Between two of them the panel has passed a self test, or there had been no second one: so it is
    not the panel, and the next test would pass as well. Called by one thread at a time.

    Args:
        clock: monotonic time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._unseen, self._ends = clock, 0, -math.inf

    def note(self, verdict: Verdict) -> None:
        """Note what one capture says of its mask; one that is undecided says nothing."""
        if verdict == "seen":
            self.release()
        elif verdict == "not seen":
            self._unseen += 1
            if self._unseen >= OFTEN:
                pause = min(_FIRST_PAUSE * 2 ** min(self._unseen - OFTEN, 10), _LONGEST_PAUSE)
                self._ends = self._clock() + pause

    def release(self) -> None:
        """What was noted so far counts no more."""
        self._unseen, self._ends = 0, -math.inf

    def holds_for(self) -> float:
        """Seconds until the panel may be tested again."""
        return max(0.0, self._ends - self._clock())


class Findings:
    """What the last captures came to. Written by one thread at a time, read by any.

    How well a capture fits depends on its scene, too, so that the mean over so many that were
    decided is compared with that of the first ones under the same calibration.
    """

    def __init__(self) -> None:
        self._last: deque[Finding] = deque(maxlen=CAPTURES)
        self._fits: deque[float] = deque(maxlen=CAPTURES)
        self._usual: float | None = None
        self._told = False
        self._lock = threading.Lock()

    def add(self, finding: Finding) -> bool:
        """Take that of one capture that was not refused.

        Returns:
            Whether the camera has drifted away from its calibration; said once.
        """
        with self._lock:
            self._last.append(finding)
            if finding.verdict != "seen":
                return False
            self._fits.append(1 - finding.departure)
            if self._told or len(self._fits) < CAPTURES:
                return False
            mean = fmean(self._fits)
            if self._usual is None:
                self._usual = mean
            self._told = mean < DRIFTED * self._usual
            return self._told

    def forget(self) -> None:
        """Another calibration holds."""
        with self._lock:
            self._last.clear()
            self._fits.clear()
            self._usual, self._told = None, False

    @property
    def means(self) -> ProofMeans | None:
        """Over the last captures; None before the first."""
        with self._lock:
            return _means(self._last) if self._last else None


def proof_note(finding: Finding) -> ProofNote:
    """What receivers are told of one capture; ValueError for one that must not leave."""
    if finding.verdict == "not seen":
        raise ValueError("nothing is told of a capture whose mask was not seen")
    return ProofNote(
        verdict=finding.verdict,
        margin=_digits(finding.margin),
        departure=_digits(finding.departure),
        light=_digits(finding.light),
    )


def _means(findings: Sequence[Finding]) -> ProofMeans:
    def mean(values: Sequence[float]) -> float:
        return _digits(float(np.mean(values)))

    return ProofMeans(
        captures=len(findings),
        undecided=mean([each.verdict == "undecided" for each in findings]),
        margin=mean([each.margin for each in findings]),
        departure=mean([each.departure for each in findings]),
        light=mean([each.light for each in findings]),
    )


def _digits(value: float) -> float:
    """Six of them: no test is better than that, and notes have a size to keep."""
    return float(f"{value:.6g}")
