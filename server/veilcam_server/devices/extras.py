"""Packages that talk to a Raspberry Pi's hardware: the extra ``pi``, and what the system brings."""

from __future__ import annotations

import importlib
from typing import Any

from veilcam_server.devices.errors import DeviceMissingError

_SYSTEM = ("libcamera", "kms", "pykms")
"""Not on any package index: Debian packages for the system's own Python."""
_FROM_SYSTEM = (
    "sudo apt install python3-libcamera python3-kms++, and make the environment with the system's "
    "python3 and --system-site-packages"
)
_FROM_EXTRA = "run pip install -e '.[server,pi]' in the checkout, in the daemon's environment"


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
        from_system = missing.partition(".")[0] in _SYSTEM
        raise DeviceMissingError(
            f"the package {missing} is not installed{needed}: "
            f"{_FROM_SYSTEM if from_system else _FROM_EXTRA}"
        ) from None
    except Exception as error:
        # A compiled package that was built for another numpy raises ValueError, for one.
        found = " ".join(f"{type(error).__name__}: {error}".split())
        remedy = f"run pip install --force-reinstall {name} in the daemon's environment"
        raise DeviceMissingError(
            f"the package {name} cannot be imported ({found}): "
            f"{_FROM_SYSTEM if name in _SYSTEM else remedy}"
        ) from None
