"""The one way this package refuses bad input.

Every message names the argument, its value, its unit and what would be valid.
"""

import math
import os
from collections.abc import Collection
from types import EllipsisType
from typing import Protocol


class OpticsError(ValueError):
    """Input that no camera can have; the message says what would be valid."""


_COMPLEX_BYTES = 16


class _HasShape(Protocol):
    @property
    def shape(self) -> tuple[int, ...]: ...


def invalid(argument: str, value: object, unit: str, valid: str) -> OpticsError:
    """Return the error for one bad argument, e.g. ``invalid("pitch", -1.0, "m", "> 0")``."""
    shown = f"{value} {unit}".strip()
    return OpticsError(f"{argument} = {shown} is not valid: use {valid}")


def require(condition: bool, argument: str, value: object, unit: str, valid: str) -> None:
    """Raise :class:`OpticsError` of one argument, as :func:`invalid` words it, unless it is met."""
    if not condition:
        raise invalid(argument, value, unit, valid)


def require_memory(argument: str, value: object, unit: str, numbers: float, valid: str) -> None:
    """Raise :class:`OpticsError` if so many complex128 ``numbers`` exceed this machine's memory."""
    there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    asked = numbers * _COMPLEX_BYTES
    size = f"{asked:.2g} bytes of this machine's {there:.2g}"
    require(asked <= there, argument, value, unit, f"{valid}: this asks for {size}")


def require_positive(argument: str, value: float, unit: str) -> None:
    """Raise :class:`OpticsError` unless ``value`` is finite and greater than zero."""
    require(math.isfinite(value) and value > 0, argument, value, unit, "a finite number > 0")


def require_count(argument: str, value: int, least: int = 1) -> None:
    """Raise :class:`OpticsError` unless ``value`` is an integer of at least ``least``."""
    whole = isinstance(value, int) and not isinstance(value, bool)
    require(whole and value >= least, argument, value, "", f"an integer >= {least}")


def require_within(argument: str, value: float, unit: str, low: float, high: float) -> None:
    """Raise :class:`OpticsError` unless ``value`` is finite and lies from ``low`` to ``high``."""
    if not (math.isfinite(value) and low <= value <= high):
        ends = f"a finite number of at least {low}" if high == math.inf else f"{low} to {high}"
        raise invalid(argument, value, unit, "a finite number" if low == -math.inf else ends)


def require_ratio(argument: str, value: float) -> None:
    """Raise :class:`OpticsError` unless ``value`` is a signal-to-noise ratio [dB], or infinity."""
    found = not math.isnan(value) and value != -math.inf
    require(found, argument, value, "dB", "a finite number, or inf for no noise")


def require_choice(argument: str, value: object, choices: Collection[object]) -> None:
    """Raise :class:`OpticsError` unless ``value`` is one of ``choices``."""
    require(value in choices, argument, repr(value), "", " or ".join(map(repr, choices)))


def require_shape(argument: str, array: _HasShape, *axes: int | str | EllipsisType) -> None:
    """Raise :class:`OpticsError` unless ``array`` has these axes.

    Args:
        argument: name of the array.
        array: array of torch or NumPy.
        axes: lengths; a name stands for an axis of any length, a leading ``...`` for any axes.
    """
    shape = tuple(array.shape)
    lengths = axes[1:] if ... in axes else axes
    last = shape[-len(lengths) :] if ... in axes else shape
    found = len(last) == len(lengths) and all(
        isinstance(wanted, str) or wanted == length
        for wanted, length in zip(lengths, last, strict=True)
    )
    valid = ", ".join("..." if axis is ... else str(axis) for axis in axes)
    require(found, f"{argument}.shape", shape, "", f"({valid})")
