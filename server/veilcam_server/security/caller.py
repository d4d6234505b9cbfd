"""The caller of a request, and what it may do."""

from __future__ import annotations

from dataclasses import dataclass

from veilcam_client.wire.tokens import Scope
from veilcam_server.errors import ProblemError


@dataclass(frozen=True, slots=True)
class Caller:
    """Caller of the API.

    Attributes:
        id: id of the token; where none is wanted, the peer's address.
        label: label of the token, for people.
        scopes: scopes of the caller.
        expires: end of the token, seconds since 1970; None: never.
        full_scores: True where the daemon tells scores in full, and not in tenths.
    """

    id: str
    label: str
    scopes: frozenset[str]
    expires: float | None = None
    full_scores: bool = False

    def may(self, scope: Scope) -> bool:
        """Return whether the caller has this scope."""
        return scope in self.scopes

    def require(self, scope: Scope) -> None:
        """Raise :class:`ProblemError` unless the caller has this scope."""
        if not self.may(scope):
            raise ProblemError(
                "forbidden", f"this token lacks the scope {scope}: ask for one that has it"
            )
