"""Bounded queue in front of the one thread that may touch the device."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Generic, NamedTuple, TypeVar

from veilcam_client.wire.events import Fault
from veilcam_server.camera.capture import Captured
from veilcam_server.camera.engine import Publish
from veilcam_server.errors import ProblemError

ResultT = TypeVar("ResultT")
_REFUSALS = ("calibration_impossible", "conflict", "light_unsteady", "not_enabled", "not_looking")
"""At which nothing failed."""


class DeviceQueue:
    """Serves requests in the order in which they came, and turns away what would wait too long.

    Args:
        limit: greatest number of requests that wait, the one at work included.
        publish: takes the faults of what was asked for.
    """

    def __init__(self, limit: int, publish: Publish) -> None:
        self.limit, self._publish = limit, publish
        self.waiting = 0
        """Requests admitted and not yet answered."""
        self._recent = 0.1
        """Smoothed time that the device takes for one request [s]."""
        self._thread = ThreadPoolExecutor(1, "device")

    @contextmanager
    def admitted(self) -> Iterator[None]:
        """Take a place in the queue; raises :class:`ProblemError` if there is none."""
        if self.waiting >= self.limit:
            pause = max(1, math.ceil(self.waiting * self._recent))
            raise ProblemError(
                "queue_full",
                f"{self.limit} captures are waiting: try again in {pause} s",
                retry_after=pause,
            )
        self.waiting += 1
        try:
            yield
        finally:
            self.waiting -= 1

    async def run(
        self, work: Callable[[], ResultT], *, counted: bool = True, told: bool = True
    ) -> ResultT:
        """Do ``work`` on the device's thread, and raise what it raises.

        Args:
            work: function that does the work.
            counted: True: the time it takes counts in the estimate for others that wait.
            told: True: a failure is published; else only the state tells of it.
        """
        job = self._thread.submit(_timed, work, time.monotonic())
        result, _ = await self._end(job, counted=counted, told=told)
        return result

    async def capture(self, take: Callable[[], Captured]) -> tuple[Captured, float]:
        """Take a capture; return it with the time that it waited for the device [s].

        A capture that was begun when its request is called off is let go of at its end.
        """
        job = self._thread.submit(_timed, take, time.monotonic())
        try:
            return await self._end(job)
        except asyncio.CancelledError:
            job.add_done_callback(_let_go)
            raise

    async def _end(
        self, job: Future[_Timed[ResultT]], *, counted: bool = True, told: bool = True
    ) -> tuple[ResultT, float]:
        """Return the result of a job and the time that it waited [s]."""
        try:
            done = await asyncio.wrap_future(job)
        except ProblemError as error:
            if told and error.code not in _REFUSALS:
                self._publish(
                    partial(Fault, code=error.code, detail=str(error), remedy=error.remedy)
                )
            raise
        if counted:
            self._recent += 0.2 * (done.took - self._recent)
        return done.result, done.waited

    def close(self) -> None:
        """End the thread once it is idle."""
        self._thread.shutdown()


class _Timed(NamedTuple, Generic[ResultT]):
    """Result of work, the time that it waited, and the time that it took [s]."""

    result: ResultT
    waited: float
    took: float


def _timed(work: Callable[[], ResultT], asked: float) -> _Timed[ResultT]:
    begun = time.monotonic()
    result = work()
    return _Timed(result, begun - asked, time.monotonic() - begun)


def _let_go(job: Future[_Timed[Captured]]) -> None:
    if not job.cancelled() and job.exception() is None:
        job.result().result.done()
