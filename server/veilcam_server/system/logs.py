"""Structured logs on standard error: JSON lines, or colours when a person looks on."""

from __future__ import annotations

import asyncio
import json
import logging
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Any, TextIO

import structlog


class LogStream:
    """A text stream that never fails: what it could not write is counted, and said afterwards.

    A full disk under the log, or a pipe that nobody reads any more, is no reason to end.

    Args:
        stream: stream to write to.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.lost = 0
        """Lines in a row that could not be written; 0 while all is well."""

    def write(self, text: str) -> int:
        """Write a line, or count it."""
        try:
            self._stream.write(text)
            self._stream.flush()
            if self.lost and text:
                lost, self.lost = self.lost, 0
                self.write(_again(lost))
        except (OSError, ValueError):  # ValueError: it is closed, or cannot encode this
            self.lost += 1
        return len(text)

    def flush(self) -> None:
        """Nothing is kept back."""

    def isatty(self) -> bool:
        """Return whether the output is a terminal."""
        return self._stream.isatty()


def _again(lost: int) -> str:
    entry = {
        "event": "log can be written again",
        "lost": lost,
        "level": "warning",
        "timestamp": datetime.now(UTC).isoformat(),
    }
    return f"{json.dumps(entry)}\n"


def configure(level: str) -> None:
    """Log everything of at least ``level`` (``debug``, ``info``, ``warning``, ``error``)."""
    stream = LogStream(sys.stderr)
    renderer: structlog.typing.Processor
    if stream.isatty():
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
        logger_factory=structlog.WriteLoggerFactory(stream),  # type: ignore[arg-type]
    )
    # What uvicorn has to say goes to the same place.
    logging.basicConfig(stream=stream, level=logging.WARNING, format="%(name)s: %(message)s")


@contextmanager
def within_a_program() -> Iterator[None]:
    """Log by the standard library's ``logging``, whose owner says what is shown and where.

    Who has configured structlog keeps that.
    """
    if structlog.is_configured():
        yield
        return
    structlog.configure(
        processors=[
            structlog.stdlib.filter_by_level,
            structlog.processors.format_exc_info,
            structlog.processors.KeyValueRenderer(key_order=["event"]),
        ],
        wrapper_class=structlog.stdlib.BoundLogger,
        logger_factory=structlog.stdlib.LoggerFactory(),
    )
    try:
        yield
    finally:
        structlog.reset_defaults()


def log_defect(error: BaseException, **context: str) -> None:
    """Log an error that nobody foresaw: its kind and where it was raised.

    Its text is left out, as it may hold anything.

    Args:
        error: error that was raised.
        context: facts known of it, such as ``during``.
    """
    structlog.get_logger().error(
        "defect",
        error=type(error).__name__,
        where=[
            f"{frame.filename}:{frame.lineno} {frame.name}"
            for frame in traceback.extract_tb(error.__traceback__)
        ],
        **context,
    )


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


def log_unhandled(_: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Log what was raised on an event loop where nobody waits for it, without its text."""
    error = context.get("exception")
    if error is not None:
        log_defect(error, during="event loop")
    else:
        structlog.get_logger().error("event loop", told=context["message"])
