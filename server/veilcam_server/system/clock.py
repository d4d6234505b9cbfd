"""Clock of this machine: time of day, time zone, and whether the kernel calls it synchronised."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime, tzinfo
from io import BytesIO
from pathlib import Path
from zoneinfo import ZoneInfo

from veilcam_client.wire.status import WallClock

ZONES = Path("/usr/share/zoneinfo")
"""Folder of zones that ``TZ`` may name."""
LOCAL = Path("/etc/localtime")
"""Zone of the machine where ``TZ`` is not set."""
_UNSYNCHRONISED = 0x0040
"""STA_UNSYNC of linux/timex.h."""


class _Timex(ctypes.Structure):
    """Beginning of struct timex of linux/timex.h, and room for the rest."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_char * 512),
    )


def kernel_synchronised() -> bool:
    """Return whether the kernel calls its clock synchronised; not if it does not answer."""
    asked = _Timex()  # modes 0: nothing is changed
    try:
        state = ctypes.CDLL(None).adjtimex(ctypes.byref(asked))
    except (OSError, AttributeError):
        return False
    return bool(state >= 0 and not asked.status & _UNSYNCHRONISED)


class MachineClock:
    """Clock of this machine, whose zone may change at any moment.

    The zone's file is read at each look: the C library reads it once for the whole process.

    Args:
        trusted: True: hours go by it though the kernel does not call it synchronised.
        kernel: tells whether it is synchronised; by default the kernel of this machine.
    """

    def __init__(self, *, trusted: bool = False, kernel: Callable[[], bool] | None = None) -> None:
        self._sure, self._kernel = trusted, kernel or kernel_synchronised
        self._content = b""
        self._zone: tzinfo = UTC

    def now(self) -> datetime:
        """Return the time of day where this machine is, with its zone as it is set now."""
        try:
            content = _zone_file().read_bytes()
        except OSError:
            self._content, self._zone = b"", UTC
            given = _given() or "/"
            # Rules in the place of a name, which the C library knows. Without a file it is UTC.
            return datetime.now(UTC) if given.startswith("/") else datetime.now().astimezone()
        if content != self._content:
            # Half a file changes nothing: the zone before holds until it is whole.
            with suppress(Exception):
                self._zone = ZoneInfo.from_file(BytesIO(content))
                self._content = content
        return datetime.now(self._zone)

    def sure(self) -> bool:
        """Return whether hours may go by it; once it was synchronised, they may from then on."""
        self._sure = self._sure or self._kernel()
        return self._sure

    def told(self) -> WallClock:
        """Return what is told of it."""
        return WallClock(zone=self._name(), synchronised=self._kernel())

    def _name(self) -> str:
        """Name of the zone; its abbreviation, where the zone's file does not tell its name."""
        file = _zone_file()
        _, found, name = str(file.resolve()).rpartition("/zoneinfo/")
        return name if found and file.is_file() else self.now().tzname() or "UTC"


def _given() -> str | None:
    """Zone of the environment."""
    given = os.environ.get("TZ")
    return None if given is None else given.removeprefix(":")


def _zone_file() -> Path:
    given = _given()
    return LOCAL if given is None else ZONES / (given or "UTC")
