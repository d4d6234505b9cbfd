"""Limits of one caller: its rate, its requests at once, and the lease of another one."""

from __future__ import annotations

import hmac
import math
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from veilcam_server.errors import ProblemError

REMEMBERED = 1024
"""Callers whose last requests are remembered."""


class RateLimit:
    """A bucket of tokens for each caller: ``burst`` at first, and ``rate`` more every second.

    Args:
        rate: requests that a caller may make in the long run [1/s].
        burst: requests that may come at once after a quiet time.
        now: a clock that is never set [s].
    """

    def __init__(self, rate: float, burst: int, now: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._burst, self._now = rate, burst, now
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def take(self, caller: str) -> None:
        """Count one request of ``caller``; raises :class:`ProblemError` if it is one too many."""
        now = self._now()
        left, since = self._buckets.get(caller, (float(self._burst), now))
        left = min(float(self._burst), left + (now - since) * self._rate)
        if left < 1:
            pause = math.ceil((1 - left) / self._rate)
            raise ProblemError(
                "too_many_requests",
                f"more than {self._rate:g} requests a second: try again in {pause} s",
                retry_after=pause,
            )
        self._buckets[caller] = (left - 1, now)
        self._buckets.move_to_end(caller)
        if len(self._buckets) > REMEMBERED:
            self._buckets.popitem(last=False)


class ConcurrencyLimit:
    """So many requests or streams of one caller may be under way at once.

    Args:
        limit: greatest number.
        refusal: refusal of one too many, which follows the limit.
    """

    def __init__(
        self,
        limit: int,
        refusal: str = "of your requests are under way: wait for one of them to end",
    ) -> None:
        self._limit, self._refusal = limit, refusal
        self._under_way: Counter[str] = Counter()

    @contextmanager
    def held(self, caller: str) -> Iterator[None]:
        """Count a request as under way; raises :class:`ProblemError` at one too many."""
        if self._under_way[caller] >= self._limit:
            raise ProblemError("too_many_requests", f"{self._limit} {self._refusal}")
        self._under_way[caller] += 1
        try:
            yield
        finally:
            self._under_way[caller] -= 1
            if not self._under_way[caller]:
                del self._under_way[caller]


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
