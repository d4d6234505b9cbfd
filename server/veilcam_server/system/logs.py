"""Structured logs on standard error: JSON lines, or colours when a person looks on."""

from __future__ import annotations

import logging
import sys

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
