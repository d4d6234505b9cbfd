"""What one capture says of its mask.

The numbers in brackets are those of docs/proof.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Verdict = Literal["seen", "not seen", "undecided"]
Alternative = Literal["before", "inverted", "transparent", "another"]

FOR = 3.3
"""Score that a mask has to reach to be seen: 1 in 800 that was not there did."""
CLEAR = 1.5
"""By which it has to be ahead of every rival (eq. 9)."""
CLEAR_OF_INVERTED = 3.0
"""The same of the inverted mask, most of whose picture is its own."""
AGAINST = 5.0
"""Score that a rival has to reach for the named mask not to be seen: of 111,552 masks
that were not there none was above 4.4."""
OPEN = 3.5
"""The same of an open window: masks have less of its mark than chance has."""
OPEN_AHEAD = 2.5
"""By which an open window has to be ahead of the named mask (eq. 11, in deviations of few
strangers, whose tails are long): of 121,176 sound captures one scene's two came to 1.6."""
BARE = 0.2
"""Unevenness (eq. 12), over that of even light behind the window, below which there is no window.
Of a panel without power it is a fifth of that, in the dimmest light."""
AROUND = 0.4
"""The same below which light may pass around the window, as where the panel is inverted."""


@dataclass(frozen=True, slots=True)
class Finding:
    """Of one capture. Every number in it is a light meter: it may leave sealed only.

    Attributes:
        verdict: whether the named mask was in front of the sensor.
        margin: by how much the named mask is ahead of the nearest alternative, in standard
            deviations of what two masks differ by that are not there (eq. 9).
        nearest: name of that alternative.
        departure: share of its mark that the named mask should have left and did not: some 0.4
            where it fits, 1 where nothing of it is there.
        light: mean of the measurement.
    """

    verdict: Verdict
    margin: float
    nearest: Alternative
    departure: float
    light: float


@dataclass(frozen=True, slots=True)
class Rival:
    """Another state of the panel, beside the mask that a capture names.

    Attributes:
        name: of the state.
        score: of its mark (eq. 8, of an open window eq. 10).
        behind: by how much the named mask is ahead of it (eq. 9, of an open window eq. 11).
    """

    name: Alternative
    score: float
    behind: float

    def convicted(self) -> bool:
        """Whether the panel is in this state, and not as the capture names it.

        A rival that is much alike is ahead by little even where it is there: then it is not
        convicted, since what a camera differs by from its drawing may be as much.
        """
        if self.name == "transparent":
            return self.score >= OPEN and self.behind <= -OPEN_AHEAD
        return self.score >= AGAINST and self.behind <= -CLEAR

    def cleared(self) -> bool:
        """Whether the named mask is ahead by enough to be seen."""
        return self.behind >= (CLEAR_OF_INVERTED if self.name == "inverted" else CLEAR)

    def inverts(self) -> bool:
        """Whether it is the inverted mask, and there rather than the named one.

        That says enough only where light passes around the window as well.
        """
        return self.name == "inverted" and self.score >= FOR and self.behind < 0


def judged(
    score: float, rivals: Sequence[Rival], *, unevenness: float, departure: float, light: float
) -> Finding:
    """What scores come to.

    Args:
        score: of the mask that the capture names.
        rivals: at least one.
        unevenness: of the light, over that of even light behind the window.
        departure: see :class:`Finding`.
        light: see :class:`Finding`.
    """
    proven = score >= AGAINST and all(rival.cleared() for rival in rivals)
    if unevenness < BARE and not proven:
        return Finding("not seen", -OPEN, "transparent", departure, light)
    nearest = min(rivals, key=lambda rival: rival.behind)
    verdict: Verdict = "undecided"
    around = unevenness < AROUND
    if nearest.convicted() or (around and nearest.inverts()):
        verdict = "not seen"
    elif score >= FOR and all(rival.cleared() for rival in rivals) and not around:
        verdict = "seen"
    return Finding(verdict, nearest.behind, nearest.name, departure, light)
