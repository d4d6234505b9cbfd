"""Findings of checks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Outcome = Literal["ok", "bad", "skipped"]
"""All is well; the daemon cannot serve as it should; or something else must be well first."""


@dataclass(frozen=True, slots=True)
class Finding:
    """Finding of the doctor, and its remedy where something is wrong."""

    name: str
    outcome: Outcome
    found: str
    remedy: str | None = None


def halves(error: Exception, path: Path | None = None) -> tuple[str, str]:
    """Split an error of ours into what is wrong, without ``path``, and what to do."""
    found, _, remedy = str(error).removeprefix(f"{path}: ").rpartition(": ")
    return (found, remedy) if found else (remedy, "export or copy it again")
