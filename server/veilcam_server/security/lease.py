"""The lease: the camera for one caller alone, for a while."""

from __future__ import annotations

import hmac
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from veilcam_server.errors import ProblemError


@dataclass(frozen=True, slots=True)
class Holding:
    """Holder of the camera, and the end of its lease on the monotonic clock [s]."""

    holder: str
    owner: str
    until: float


class Lease:
    """Ends by itself, so that a holder that is gone keeps nobody out for long.

    Args:
        now: a clock that is never set [s].
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._holding: Holding | None = None

    @property
    def holding(self) -> Holding | None:
        """None while nobody holds the camera."""
        if self._holding is not None and self._now() >= self._holding.until:
            self._holding = None
        return self._holding

    @property
    def left(self) -> float | None:
        """Until the lease ends [s]; None while there is none."""
        holding = self.holding
        return None if holding is None else holding.until - self._now()

    def held_by(self, holder: str) -> bool:
        """Return whether this one holds the camera."""
        holding = self.holding
        # Where no tokens are wanted, the name of the holder is a secret.
        return holding is not None and hmac.compare_digest(holding.holder.encode(), holder.encode())

    def require(self, holder: str) -> None:
        """Raise :class:`ProblemError` if somebody else holds the camera."""
        holding = self.holding
        if holding is not None and not self.held_by(holder):
            left = max(1, math.ceil(holding.until - self._now()))
            raise ProblemError(
                "leased",
                f"the camera is leased to {holding.owner!r} for another {left} s",
                retry_after=left,
            )

    def take(self, holder: str, owner: str, seconds: float) -> None:
        """Hold the camera, or go on holding it; raises :class:`ProblemError`."""
        self.require(holder)
        self._holding = Holding(holder, owner, self._now() + seconds)

    def release(self, holder: str) -> None:
        """Hold it no longer; raises :class:`ProblemError` if somebody else does."""
        self.require(holder)
        self._holding = None

    def break_off(self) -> str | None:
        """End it, whoever holds the camera, and return who did; None: nobody."""
        holding = self.holding
        self._holding = None
        return None if holding is None else holding.owner
