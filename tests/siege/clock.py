"""Wall clock of daemons under siege, loaded before all that looks at one."""

from __future__ import annotations

import time
from multiprocessing.sharedctypes import Synchronized

_right = time.time
shift: Synchronized[float] | None = None
"""Shift of a daemon's clock [s]; None for a right one."""


def now() -> float:
    return _right() + (0.0 if shift is None else shift.value)


time.time = now
