"""How much one caller may ask: how often, and how much at once."""

from __future__ import annotations

import math
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from veilcam_server.errors import RateLimitError, TooManyRequestsError, TooManyStreamsError

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
        """Count one request of ``caller``; raises :class:`RateLimitError` if it is one too many."""
        now = self._now()
        left, since = self._buckets.get(caller, (float(self._burst), now))
        left = min(float(self._burst), left + (now - since) * self._rate)
        if left < 1:
            raise RateLimitError(self._rate, math.ceil((1 - left) / self._rate))
        self._buckets[caller] = (left - 1, now)
        self._buckets.move_to_end(caller)
        if len(self._buckets) > REMEMBERED:
            self._buckets.popitem(last=False)


class ConcurrencyLimit:
    """So many requests of one caller may be under way at once."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._under_way: Counter[str] = Counter()

    @contextmanager
    def held(self, caller: str) -> Iterator[None]:
        """Count a request as under way; raises :class:`TooManyRequestsError`."""
        if self._under_way[caller] >= self._limit:
            raise TooManyRequestsError(self._limit)
        self._under_way[caller] += 1
        try:
            yield
        finally:
            self._under_way[caller] -= 1
            if not self._under_way[caller]:
                del self._under_way[caller]


class StreamLimit:
    """So many event streams may be open, all callers together."""

    def __init__(self, limit: int) -> None:
        self._limit, self._open = limit, 0

    @contextmanager
    def held(self) -> Iterator[None]:
        """Count a stream as open; raises :class:`TooManyStreamsError`."""
        if self._open >= self._limit:
            raise TooManyStreamsError(self._limit)
        self._open += 1
        try:
            yield
        finally:
            self._open -= 1
