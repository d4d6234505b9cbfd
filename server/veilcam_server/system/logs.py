"""Structured logs on standard error: JSON lines, or colours when a person looks on."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable

import structlog


def configure(level: str) -> None:
    """Log everything of at least ``level`` (``debug``, ``info``, ``warning``, ``error``)."""
    renderer: structlog.typing.Processor
    if sys.stderr.isatty():
        # Plain tracebacks: the fancy ones print local variables, and those hold masks.
        renderer = structlog.dev.ConsoleRenderer(exception_formatter=structlog.dev.plain_traceback)
        exceptions: list[structlog.typing.Processor] = []
    else:
        renderer = structlog.processors.JSONRenderer()
        exceptions = [structlog.processors.format_exc_info]
    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            *exceptions,
            renderer,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(
            logging.getLevelNamesMapping()[level.upper()]
        ),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
    )
    # What uvicorn has to say goes to the same place.
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format="%(name)s: %(message)s")


class Throttle:
    """Says when a line about what happens often is due: at most one in ``interval``.

    Args:
        interval: between two lines [s].
        now: a clock that is never set [s].
    """

    def __init__(self, interval: float = 60.0, now: Callable[[], float] = time.monotonic) -> None:
        self._interval, self._now = interval, now
        self._last: float | None = None
        self._count = 0

    def due(self) -> int | None:
        """Count one more; return how many the line that is due stands for, None if none is."""
        self._count += 1
        now = self._now()
        if self._last is not None and now - self._last < self._interval:
            return None
        count, self._last, self._count = self._count, now, 0
        return count
