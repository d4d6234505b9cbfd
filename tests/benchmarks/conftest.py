"""The server's benches, which measurements are tried on."""

import json
from pathlib import Path
from typing import Any

from tests.unit.server.conftest import (
    _no_settings_from_outside,
    _own_logs,
    anyio_backend,
    bench,
    bundle,
)
from tests.unit.training.conftest import digit_folder, source

__all__ = [
    "_no_settings_from_outside",
    "_own_logs",
    "anyio_backend",
    "bench",
    "bundle",
    "digit_folder",
    "source",
]


def figures_of(path: Path) -> dict[str, Any]:
    return {name: entry["value"] for name, entry in json.loads(path.read_text()).items()}
