"""Packages that talk to a Raspberry Pi's hardware: some come along, the others are the system's."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from functools import partial
from typing import Any, Final

from veilcam_server.devices.errors import DeviceMissingError, Refused, in_one_line

_OF_THE_SYSTEM: Final[Mapping[str, str]] = {
    "libcamera": "python3-libcamera",
    "kms": "python3-kms++",
    "pykms": "python3-kms++",
    "picamera2": "python3-picamera2",
    "numpy": "python3-numpy",
    "spidev": "python3-spidev",
}
"""Packages that are built for the system's own Python, libraries and NumPy, and Debian's names."""
_COMES_ALONG = "install the package veilcam again (sudo apt install --reinstall ./veilcam_*.deb)"


def import_extra(name: str) -> Any:
    """Import a package.

    Raises:
        DeviceMissingError: it or what it needs is not installed, is too old, or fails in whatever
            way while it is imported; one line that ends with what to do.
    """
    with Refused(partial(_not_imported, name)):
        module = importlib.import_module(name)
        if name == "gpiod" and hasattr(module, "Chip") and not hasattr(module, "request_lines"):
            raise DeviceMissingError(
                "the package gpiod is version 1, and version 2 is needed: run "
                "pip install 'gpiod>=2.1' in the daemon's environment"
            )
        return module


def _not_imported(name: str, error: Exception) -> DeviceMissingError:
    if isinstance(error, ModuleNotFoundError):
        missing = error.name or name
        needed = "" if missing == name else f", which {name} needs"
        package = _OF_THE_SYSTEM.get(missing.partition(".")[0])
        if package is None and missing != name:
            # What a package of the system's needs comes with it.
            package = _OF_THE_SYSTEM.get(name)
        remedy = _COMES_ALONG if package is None else f"sudo apt install {package}"
        return DeviceMissingError(f"the package {missing} is not installed{needed}: {remedy}")
    # A compiled package that was built for another numpy raises ValueError, for one.
    return DeviceMissingError(
        f"the package {name} cannot be imported ({in_one_line(error)}): {reinstall(name)}"
    )


def reinstall(name: str) -> str:
    """Return what to do about a package that is there and does not work."""
    package = _OF_THE_SYSTEM.get(name)
    if package is None:
        return _COMES_ALONG
    return (
        f"sudo apt install --reinstall {package}, and remove what pip put beside it "
        "(sudo pip uninstall --break-system-packages numpy simplejpeg)"
    )
