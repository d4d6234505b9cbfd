"""The log of a daemon, as tests open and read it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from veilcam_client.keys.log import read_line
from veilcam_client.wire.log import LogRecord
from veilcam_server.sealing.identity import DeviceKey
from veilcam_server.security.log import FOLDER, Log
from veilcam_server.system.state_file import log_fault


def open_log(state_dir: Path, **limits: int) -> Log:
    return Log(state_dir / FOLDER, DeviceKey.open(state_dir), log_fault, **limits)


def records(state_dir: Path) -> list[LogRecord]:
    """All records that can be read, the oldest first."""
    files = sorted((state_dir / FOLDER).glob("*.jsonl"))
    lines = [line for path in files for line in path.read_bytes().split(b"\n")]
    return [record for line in lines if (record := read_line(line)) is not None]


def events(state_dir: Path, *kinds: str) -> list[dict[str, Any]]:
    """Facts of the events of some kinds, or of all, with ``kind`` and ``at``."""
    return [
        {"kind": each.kind, "at": each.at, **each.facts}
        for each in records(state_dir)
        if not kinds or each.kind in kinds
    ]
