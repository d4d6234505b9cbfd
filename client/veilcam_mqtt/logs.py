"""Logs on standard error: a line a person reads on a terminal, JSON lines otherwise."""

from __future__ import annotations

import json as encoder
import logging
import sys
from datetime import UTC, datetime


class JsonFormatter(logging.Formatter):
    """One JSON object a line."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line; of an error that was raised, its kind, and not its text."""
        entry = {
            "event": record.getMessage(),
            "level": record.levelname.lower(),
            "timestamp": datetime.fromtimestamp(record.created, UTC).isoformat(),
        }
        if record.exc_info and record.exc_info[0] is not None:
            entry["error"] = record.exc_info[0].__name__
        return encoder.dumps(entry)


def configure(level: str, *, json: bool) -> None:
    """Log everything of at least ``level`` (``debug``, ``info``, ``warning``, ``error``)."""
    handler = logging.StreamHandler(sys.stderr)
    words = logging.Formatter("%(asctime)s  %(levelname)-7s  %(message)s")
    handler.setFormatter(JsonFormatter() if json else words)
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    logging.getLogger("veilcam").setLevel(level.upper())
