"""Hiding of a bundle's masks: keyless figures, bound to the masks, and their sentences."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from veilcam_training.bundle.errors import require

LEAST_PINHOLE = 0.95
"""Share that an eye picks behind one pinhole; below it the eye says nothing of that size."""
MARGIN = 0.05
"""Share that an eye may see above random masks."""


@dataclass(frozen=True)
class Hiding:
    """Shares that attackers without a key get right; each is between 0 and 1.

    Attributes:
        digest: SHA-256 of the masks, of :func:`masks_digest`, hexadecimal.
        masks: number of masks that were measured.
        scenes: scenes that an eye chose from, in groups of a hundred.
        worst: number of the mask that an eye sees most through.
        seen: share of scenes that an eye picks out of a hundred, behind that mask.
        random_seen: same share behind random masks, their mean.
        pinhole_seen: same share behind one pinhole.
        recognised: share that a machine with candidates picks out of a hundred; the worst mask.
        random_recognised: same share behind random masks.
        read: share of labels that a machine reads; the worst mask; None without a task.
        random_read: same share behind random masks.
        read_chance: share of labels that a guess gets right.
    """

    digest: str
    masks: int
    scenes: int
    worst: int
    seen: float
    random_seen: float
    pinhole_seen: float
    recognised: float
    random_recognised: float
    read: float | None = None
    random_read: float | None = None
    read_chance: float | None = None

    def __post_init__(self) -> None:
        reading = (self.read, self.random_read, self.read_chance)
        known = [share for share in reading if share is not None]
        shares = (
            *(self.seen, self.random_seen, self.pinhole_seen),
            *(self.recognised, self.random_recognised, *known),
        )
        require(
            all(0 <= share <= 1 for share in shares)
            and len(known) in (0, len(reading))
            and 0 <= self.worst < self.masks
            and self.scenes >= 1,
            f"hiding = {self} is not valid: use shares of 0 to 1, and at least 1 mask and scene",
        )

    @property
    def bounded(self) -> bool:
        """True where an eye finds what one pinhole of this size shows."""
        return self.pinhole_seen >= LEAST_PINHOLE

    @property
    def visible(self) -> bool:
        """True where a mask shows pictures of the scene."""
        return shows(self.seen, self.random_seen, self.pinhole_seen)


def shows(seen: float, random_seen: float, pinhole_seen: float) -> bool:
    """Return whether an eye sees more than behind random masks, where it can see at all."""
    return pinhole_seen >= LEAST_PINHOLE and seen > random_seen + MARGIN


def masks_digest(masks: Iterable[npt.NDArray[Any]]) -> str:
    """Return the SHA-256 of masks' levels in their order, or of a distribution's arrays."""
    digest = hashlib.sha256()
    for levels in masks:
        digest.update(f"{levels.shape}".encode())
        digest.update(np.ascontiguousarray(levels, np.uint8).tobytes())
    return digest.hexdigest()


def sentences(hiding: Hiding) -> tuple[str, ...]:
    """Return the figures in words, a sentence for each attacker."""
    if hiding.bounded:
        answer = "yes" if hiding.visible else "no"
        seen = (
            f"An eye sees pictures of the scene: {answer} ({_percent(hiding.seen)} of scenes "
            f"picked out of 100; {_percent(hiding.random_seen)} behind random masks, "
            f"{_percent(hiding.pinhole_seen)} behind a pinhole)."
        )
    else:
        seen = "This size shows too few numbers for an eye: no bound holds."
    told = [
        seen,
        f"A machine with candidates recognises {_percent(hiding.recognised)} of scenes out of 100 "
        f"({_percent(hiding.random_recognised)} behind random masks, chance 1 %).",
    ]
    if None not in (hiding.read, hiding.random_read, hiding.read_chance):
        told.append(
            f"A machine without the key reads {_percent(hiding.read)} of the labels "
            f"({_percent(hiding.random_read)} behind random masks, "
            f"chance {_percent(hiding.read_chance)})."
        )
    return tuple(told)


def _percent(share: float | None) -> str:
    return f"{100 * (share or 0):.0f} %"
