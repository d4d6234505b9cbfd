"""Total deadline of a call, in the form of a timeout that knows its end."""

from __future__ import annotations

import math
import time
from contextlib import AbstractContextManager, nullcontext
from enum import Enum
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

if TYPE_CHECKING:
    import asyncio


class _CameraTimeout(Enum):
    CAMERA_TIMEOUT = "that of the camera"


CAMERA_TIMEOUT: Final = _CameraTimeout.CAMERA_TIMEOUT
"""The ``timeout`` that the camera was made with."""
CallTimeout: TypeAlias = float | Literal[_CameraTimeout.CAMERA_TIMEOUT] | None
"""Seconds that a call may take in all; None: as long as it takes."""


LONGEST = 1e6
"""Longest wait that every operating system takes [s]."""


class Limit(float):
    """Longest wait for one operation of a socket [s], and the moment when all of them end.

    httpx and httpcore hand a timeout on as the object that it is: where it reaches the socket, what
    is left of the whole is known. To all others it is a number.
    """

    until: float

    @classmethod
    def of(cls, seconds: float, until: float) -> Limit:
        """``seconds``, or less where ``until`` (monotonic clock) [s] comes before."""
        limit = cls(min(seconds, LONGEST, max(0.0, until - time.monotonic())))
        limit.until = until
        return limit

    def left(self) -> float:
        """Return the time left for the next operation [s]; not above zero: none."""
        return min(float(self), self.until - time.monotonic())


def until(timeout: float | None) -> float:
    """Moment on the monotonic clock [s], that many seconds from now."""
    return math.inf if timeout is None else time.monotonic() + timeout


def async_within(deadline: float) -> asyncio.Timeout:
    """Return a context that ends at a deadline on the monotonic clock [s]."""
    import asyncio  # noqa: PLC0415 - late: a third of what the SDK would load

    left = None if math.isinf(deadline) else max(0.0, deadline - time.monotonic())
    return asyncio.timeout(left)


def within(_: float) -> AbstractContextManager[None]:
    """Return a context that leaves the deadline to the sockets, as :class:`Limit`."""
    return nullcontext()
