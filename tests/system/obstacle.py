"""What keeps this machine from running a check of a whole system."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping


def obstacle(tools: Mapping[str, str]) -> str | None:
    missing = [package for tool, package in tools.items() if shutil.which(tool) is None]
    if missing:
        return f"programs are missing: apt install {' '.join(missing)}"
    if os.geteuid() != 0:
        return "a root of Debian takes root rights: run it with sudo"
    return None
