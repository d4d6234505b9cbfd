"""Errors of a panel or a sensor. No message ever holds a level or a measurement."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType

from veilcam_server.errors import NamedError


class DeviceError(Exception):
    """Base: a panel or sensor that did not do what it was asked."""


class DeviceMissingError(DeviceError):
    """A device that the configuration names and that is not there."""


class DisplayError(NamedError, DeviceError, code="display_failed"):
    """The panel did not take a mask; what it shows now is unknown."""


class SensorError(NamedError, DeviceError, code="sensor_failed"):
    """The sensor gave no measurement."""


class LightError(SensorError, remedy="adjust_light"):
    """There is too much light, or nothing that it could come from."""


class SaturatedError(LightError):
    """There is too much light for the shortest exposure."""


class SensorHungError(SensorError, remedy="restart"):
    """The sensor's driver does not let go of it: only another process may have it."""


_LONGEST = 200
"""Characters of a library's text that are repeated."""


class Refused:
    """Context in which any exception of a library becomes one error of ours.

    Only text passes. The exception itself is dropped: its traceback would keep what the library
    had half made, and with it the camera or the bus.

    Args:
        blame: makes the error of the exception, and does not keep it.
    """

    def __init__(self, blame: Callable[[Exception], DeviceError]) -> None:
        self._blame = blame

    def __enter__(self) -> None:
        """Enter the library."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Raise the error of ours in the place of an exception that is none."""
        if not isinstance(error, Exception) or isinstance(error, DeviceError):
            return
        refusal = self._blame(error)
        # Neither this frame, which the new traceback has, nor the new error may lead to it.
        del error, traceback
        try:
            raise refusal from None
        finally:
            refusal.__context__ = None
            del refusal


def in_one_line(error: Exception) -> str:
    """Return the kind and the text of a library's exception."""
    text = f"{type(error).__name__}: {error}"
    printable = "".join(sign if sign.isprintable() else " " for sign in text)
    return " ".join(printable.split()).rstrip(":")[:_LONGEST]


def without_text(error: Exception) -> str:
    """Return the system's reason, or else the kind, of an exception that may tell of a mask."""
    reason = error.strerror if isinstance(error, OSError) else None
    return reason or type(error).__name__
