"""When to ask again: exponential backoff with full jitter, or what the server asks for."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field

from veilcam_client.errors import VeilcamError


@dataclass(frozen=True, slots=True)
class RetryPolicy:
    """Wait ``uniform(0, min(cap, base 2^attempt))`` [s], plus the server's Retry-After.

    Full jitter spreads clients that failed together (Brooker, "Exponential backoff and jitter",
    2015). A Retry-After longer than ``patience`` [s] is not waited for: the error is raised.
    """

    retries: int = 2
    base: float = 0.25
    cap: float = 4.0
    patience: float = 30.0
    uniform: Callable[[float, float], float] = field(
        default=random.SystemRandom().uniform, repr=False
    )

    def delay(self, attempt: int, error: VeilcamError) -> float | None:
        """Seconds to wait after failure number ``attempt`` (from 0), or None to give up."""
        if not error.retryable or attempt >= self.retries:
            return None
        asked = error.retry_after or 0.0
        if asked > self.patience:
            return None
        return asked + self.uniform(0.0, min(self.cap, self.base * 2.0**attempt))
