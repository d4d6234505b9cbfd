"""The one way this package refuses bad input.

Every message names the argument, its value, its unit and what would be valid.
"""

from __future__ import annotations

import math


class OpticsError(ValueError):
    """Input that no camera can have; the message says what would be valid."""


def invalid(argument: str, value: object, unit: str, valid: str) -> OpticsError:
    """Return the error for one bad argument, e.g. ``invalid("pitch", -1.0, "m", "> 0")``."""
    shown = f"{value} {unit}".strip()
    return OpticsError(f"{argument} = {shown} is not valid: use {valid}")


def require_positive(argument: str, value: float, unit: str) -> None:
    """Raise :class:`OpticsError` unless ``value`` is finite and greater than zero."""
    if not (math.isfinite(value) and value > 0):
        raise invalid(argument, value, unit, "a finite number > 0")


def require_count(argument: str, value: int, least: int = 1) -> None:
    """Raise :class:`OpticsError` unless ``value`` is an integer of at least ``least``."""
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise invalid(argument, value, "", f"an integer >= {least}")


def require_within(argument: str, value: float, unit: str, low: float, high: float) -> None:
    """Raise :class:`OpticsError` unless ``value`` is finite and lies from ``low`` to ``high``."""
    if not (math.isfinite(value) and low <= value <= high):
        ends = f"a finite number of at least {low}" if high == math.inf else f"{low} to {high}"
        raise invalid(argument, value, unit, "a finite number" if low == -math.inf else ends)
