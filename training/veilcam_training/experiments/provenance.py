"""Where an artefact comes from: enough to make it again."""

from __future__ import annotations

import platform
import shlex
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version

import torch
from pydantic import JsonValue
from torch import distributed

from veilcam_training.experiments.records import commit, own_command


def provenance(settings: JsonValue, digests: Mapping[str, str]) -> dict[str, JsonValue]:
    """Settings, data, versions, date and command, as JSON."""
    return {
        "settings": settings,
        "data_sha256": dict(digests),
        "versions": {
            "veilcam": version("veilcam"),
            "torch": torch.__version__,
            "python": platform.python_version(),
        },
        "processes": distributed.get_world_size() if distributed.is_initialized() else 1,
        "commit": commit(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": shlex.join(own_command()),
    }
