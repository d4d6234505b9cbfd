"""What a daemon tells of itself to who looks for a fault."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from importlib.metadata import version

from pydantic import JsonValue

from veilcam_client.wire.base import EXAMPLE_TIME, Answer
from veilcam_client.wire.status import Remedy, State


class PastState(Answer):
    """A state that the daemon entered."""

    at: datetime
    state: State
    detail: str | None
    remedy: Remedy | None = None


class PastFault(Answer):
    """Something that failed; ``code`` is that of the problem."""

    at: datetime
    code: str
    detail: str
    remedy: Remedy = "wait"


class Diagnostics(Answer):
    """Versions, settings, and what happened lately. No secret is in it."""

    versions: Mapping[str, str]
    """Of the interpreter, the system, and the packages that matter."""
    settings: Mapping[str, JsonValue]
    """What the daemon was told; ``"given"`` stands for a path, an address or a label."""
    states: tuple[PastState, ...]
    """The last ones, the latest last."""
    faults: tuple[PastFault, ...]
    """The last ones, the latest last."""
    events: Mapping[str, int]
    """How many of each kind there were since the start."""
    fault_counts: Mapping[str, int]
    """How many of each code there were since the start."""
    audit_lost: int
    """Lines of the audit log that could not be written."""


EXAMPLES = (
    Diagnostics(
        versions={"veilcam": version("veilcam"), "python": "3.11.9"},
        settings={"device": "pi", "queue_limit": 8, "bundle": "given"},
        states=(PastState(at=EXAMPLE_TIME, state="ready", detail=None),),
        faults=(
            PastFault(
                at=EXAMPLE_TIME,
                code="sensor_timeout",
                detail="no frame in 5 s",
                remedy="check_camera_cable",
            ),
        ),
        events={"capture": 1200, "mask": 120},
        fault_counts={"sensor_timeout": 1},
        audit_lost=0,
    ),
)
