"""A token in words, without what other answers are put into words with: ``veilcamd`` has it too."""

from collections.abc import Iterable
from datetime import UTC, datetime

from veilcam_client.wire.tokens import ROLES, SCOPES, Token

SCOPE_HELP = f"What it allows; give it several times. One of {', '.join(SCOPES)}."
"""Help of the option ``--scope``."""

ROLE_HELP = f"Role of the token: {', '.join(ROLES)}."
"""Help of the option ``--role``."""


def unknown_scopes(scopes: Iterable[str]) -> str | None:
    """Say which scopes there are not, as they were typed; None where all are known."""
    unknown = [scope for scope in dict.fromkeys(scopes) if scope not in SCOPES]
    if not unknown:
        return None
    typed = " ".join(f"--scope {scope!r}" for scope in unknown)
    return f"{typed}: there is no such scope: use {', '.join(SCOPES)}"


def token_in_words(token: Token) -> str:
    """Return a token in two lines."""
    used = f"used {token.last_used_on}" if token.last_used_on else "never used"
    allowed = token.role or " ".join(token.scopes)
    return f"{token.id}  {_validity(token):<24}  {used:<15}  {token.label}\n{'':14}{allowed}"


def _validity(token: Token) -> str:
    if token.revoked_at is not None:
        return f"revoked {token.revoked_at:%Y-%m-%d}"
    if token.expires_at is None:
        return "until it is revoked"
    word = "expired" if token.expires_at <= datetime.now(UTC) else "until"
    return f"{word} {token.expires_at:%Y-%m-%d %H:%M}"
