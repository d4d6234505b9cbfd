"""What the daemon itself refuses or fails at; device errors live in ``devices/errors.py``."""

from __future__ import annotations


class StartError(Exception):
    """The daemon cannot start; one line that says what to do."""


class EpochError(Exception):
    """A mask epoch could not be recorded, so no mask may be shown under it."""


class FenceError(Exception):
    """A reading that was not wholly exposed under one settled mask; it is thrown away."""


class NotReadyError(Exception):
    """The camera is in no state to take a capture."""


class RotationImpossibleError(Exception):
    """There is no other mask to change to."""


class WithheldError(Exception):
    """An embedding was asked for, and this daemon lets none out."""


class QueueFullError(Exception):
    """Too many captures are waiting already; ``retry_after`` [s]."""

    def __init__(self, limit: int, retry_after: int) -> None:
        super().__init__(f"{limit} captures are waiting: try again in {retry_after} s")
        self.retry_after = retry_after


class IdempotencyError(Exception):
    """An idempotency key that came before with another request."""


class ForbiddenError(Exception):
    """The caller's token lacks a scope."""

    def __init__(self, scope: str) -> None:
        super().__init__(f"this token lacks the scope {scope}: ask for one that has it")
