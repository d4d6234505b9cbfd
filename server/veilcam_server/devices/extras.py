"""Packages that talk to a Raspberry Pi's hardware: some come along, the others are the system's."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any, Final

from veilcam_server.devices.errors import DeviceMissingError

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
        DeviceMissingError: it or what it needs is not installed, or fails in whatever way while it
            is imported; one line that ends with what to do.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        missing = error.name or name
        needed = "" if missing == name else f", which {name} needs"
        package = _OF_THE_SYSTEM.get(missing.partition(".")[0])
        if package is None and missing != name:
            # What a package of the system's needs comes with it.
            package = _OF_THE_SYSTEM.get(name)
        remedy = _COMES_ALONG if package is None else f"sudo apt install {package}"
        raise DeviceMissingError(
            f"the package {missing} is not installed{needed}: {remedy}"
        ) from None
    except Exception as error:
        # A compiled package that was built for another numpy raises ValueError, for one.
        found = " ".join(f"{type(error).__name__}: {error}".split())
        package = _OF_THE_SYSTEM.get(name)
        remedy = (
            _COMES_ALONG
            if package is None
            else f"sudo apt install --reinstall {package}, and remove what pip put beside it "
            "(sudo pip uninstall --break-system-packages numpy simplejpeg)"
        )
        raise DeviceMissingError(
            f"the package {name} cannot be imported ({found}): {remedy}"
        ) from None
