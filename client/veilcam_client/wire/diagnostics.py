"""What a daemon tells of itself to who looks for a fault."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime

from pydantic import JsonValue

from veilcam_client.wire.captures import Answer, State


class PastState(Answer):
    """A state that the daemon entered."""

    at: datetime
    state: State
    detail: str | None


class PastFault(Answer):
    """Something that failed; ``code`` is that of the problem."""

    at: datetime
    code: str
    detail: str


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
