"""What is on the panel, and what was read behind it."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from datetime import datetime

from veilcam_client.wire.captures import Replay
from veilcam_server.devices.protocols import Reading
from veilcam_server.masks import Mask, Reader

_RANDOM = secrets.SystemRandom()


@dataclass(eq=False, slots=True)
class Showing:
    """The mask on the panel: mask, epoch and time belong together and are replaced together."""

    mask: Mask = field(repr=False)
    epoch: str
    """Name of the epoch."""
    since: float
    """When it was first shown, monotonic [s]."""
    completed_at: float
    """When it was last written; later than ``since`` when it was put back after a failure."""
    chance: float = field(default_factory=_RANDOM.random)
    """How much of a policy's jitter it gets."""
    captures: int = 0
    overdue: int = 0
    """Captures taken while it was due and the next was not ready."""
    late: bool = False
    """Whether a capture was due before the next mask was ready."""

    def reuse(self, limit: int, lateness: Lateness) -> bool:
        """Whether it may serve one more capture although it is due, which is then counted.

        Args:
            limit: how often it may.
            lateness: where that is counted, too.
        """
        if not self.late:
            self.late = True
            lateness.late += 1
        if self.overdue >= limit:
            return False
        self.overdue += 1
        lateness.reused += 1
        return True


@dataclass(frozen=True, slots=True)
class Captured:
    """One reading, proof of its mask, and the one reader that may read it."""

    embedding: Reading = field(repr=False)
    taken_at: datetime
    epoch: str
    reader: Reader = field(repr=False)
    started_after_shown: float
    settle: float
    duration: float
    rotation_time: float
    settle_time: float
    capture_time: float
    scene: int | None = None
    """Number of what a simulated camera looked at."""
    replay: Replay | None = None
    """From a recording: nothing was exposed, and the times are the recording's."""


@dataclass(slots=True)
class Lateness:
    """What it came to that the next mask was not ready."""

    late: int = 0
    """Masks that a capture found due before the next one was ready."""
    reused: int = 0
    """Captures taken under a mask that was due."""
