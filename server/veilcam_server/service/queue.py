"""Bounded queue in front of the one thread that may touch the device."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

from veilcam_server.errors import QueueFullError

ResultT = TypeVar("ResultT")


class DeviceQueue:
    """Serves requests in the order in which they came, and turns away what would wait too long.

    Args:
        limit: how many requests may wait, the one at work included.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._waiting = 0
        self._recent = 0.1
        """Smoothed time that the device takes for one request [s]."""
        self._thread = ThreadPoolExecutor(1, "device")

    @property
    def waiting(self) -> int:
        """Requests admitted and not yet answered."""
        return self._waiting

    @contextmanager
    def admitted(self) -> Iterator[None]:
        """Take a place in the queue; raises :class:`QueueFullError` if there is none."""
        if self._waiting >= self.limit:
            wait = max(1, math.ceil(self._waiting * self._recent))
            raise QueueFullError(self.limit, wait)
        self._waiting += 1
        try:
            yield
        finally:
            self._waiting -= 1

    async def run(self, work: Callable[[], ResultT], *, counted: bool = True) -> ResultT:
        """Do ``work`` on the device's thread, and raise what it raises.

        Args:
            work: to do.
            counted: whether the time it takes tells of those that others wait for.
        """

        def timed() -> tuple[ResultT, float]:
            begun = time.monotonic()
            return work(), time.monotonic() - begun

        result, took = await asyncio.get_running_loop().run_in_executor(self._thread, timed)
        if counted:
            self._recent += 0.2 * (took - self._recent)
        return result

    def close(self) -> None:
        """End the thread once it is idle."""
        self._thread.shutdown()
