"""The outcome of one check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Self

Outcome = Literal["ok", "bad", "skipped"]


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found, and if it is not well, what to do about it."""

    name: str
    outcome: Outcome
    found: str
    remedy: str | None = None

    @classmethod
    def ok(cls, name: str, found: str) -> Self:
        """All is well."""
        return cls(name, "ok", found)

    @classmethod
    def bad(cls, name: str, found: str, remedy: str) -> Self:
        """The daemon cannot serve, or not as it should."""
        return cls(name, "bad", found, remedy)

    @classmethod
    def skipped(cls, name: str, why: str) -> Self:
        """It cannot be checked before something else is well."""
        return cls(name, "skipped", why)
