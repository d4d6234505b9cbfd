"""The machine as a doctor sees it: files, packages, programs and devices; tests have another."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from veilcam_client.wire.status import WallClock
from veilcam_server.devices.extras import import_extra
from veilcam_server.devices.picamera import open_picamera2
from veilcam_server.devices.spi import gpio_chips, line_user
from veilcam_server.system.clock import MachineClock


def _run(*command: str) -> str | None:
    """Return the output of a program; None if it is missing or fails."""
    if shutil.which(command[0]) is None:
        return None
    try:
        done = subprocess.run(  # noqa: S603 - of our own choice
            command, capture_output=True, text=True, timeout=10, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


@dataclass(frozen=True, slots=True)
class Machine:
    """Machine that a doctor examines."""

    root: Path = Path("/")
    load: Callable[[str], object] = import_extra
    """Imports a package; raises :class:`DeviceMissingError`."""
    may_write: Callable[[Path], bool] = lambda path: os.access(path, os.R_OK | os.W_OK)
    """Whether this user may read and write a file."""
    run: Callable[..., str | None] = _run
    """What a program prints; None if it is not there or fails."""
    clock: Callable[[], WallClock] = lambda: MachineClock().told()
    """What is told of the clock."""
    free: Callable[[Path], int] = lambda path: shutil.disk_usage(path).free
    """Room on the disk of a directory [bytes]."""
    chips: Callable[[], Mapping[str, Path]] = gpio_chips
    """GPIO chips by label; needs gpiod."""
    line_user: Callable[[Path, int], str | None] = line_user
    """Who has a line; needs gpiod."""
    open_camera: Callable[[int], Any] = open_picamera2
    """Opens a camera; needs picamera2."""

    def path(self, path: Path | str) -> Path:
        """Return an absolute path as it is on this machine."""
        return self.root / str(path).lstrip("/")

    def text(self, path: Path | str) -> str | None:
        """Return a file's text; None if it cannot be read."""
        try:
            return self.path(path).read_text("utf-8", "replace").strip("\0\n ")
        except OSError:
            return None
