"""``card.json``: what attacks on a bundle's masks found, beside the masks that they were tried on.

A card may be lost, void or bad, and the bundle is the same: nothing is refused for what a card
says. A card of other masks than those it lies beside is no card.
"""

import hashlib
import json
from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, Field, ValidationError

MAX_ROWS = 64
CARD = "card.json"

Outcome = Literal["PASS", "FAIL", "NOT CLAIMED"]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Line = Annotated[str, Field(max_length=600)]
Name = Annotated[str, Field(min_length=1, max_length=64)]


class Finding(BaseModel, frozen=True, extra="forbid", strict=True):
    """Result of one attack; the worst of a row is the row's own."""

    attack: Line
    figure: Finite
    """In the row's unit."""


class CardRow(BaseModel, frozen=True, extra="forbid", strict=True):
    """One threat: what its worst attacker reached, and what had been said beforehand."""

    threat: Annotated[str, Field(pattern=r"^T[0-9]$")]
    title: Line
    given: Line
    """What the attacker holds."""
    attack: Line
    """The attack that was worst on data set apart."""
    metric: Line
    figure: Finite
    end: Finite
    """Of the one-sided interval: the upper end, or the lower one of a row that has to succeed."""
    unit: Name
    chance: Finite
    """The figure of an attacker who sees nothing."""
    threshold: Finite
    reason: Line
    """Of the threshold."""
    samples: Annotated[int, Field(ge=1)]
    masks: Annotated[int, Field(ge=1)]
    outcome: Outcome
    others: tuple[Finding, ...] = ()
    """All attacks that were tried, with what each reached on the same data."""
    notes: tuple[Line, ...] = ()


class PrivacyCard(BaseModel, frozen=True, extra="forbid", strict=True):
    """All rows, and what they are of."""

    format: Literal["veilcam-card"] = "veilcam-card"
    version: Literal[1] = 1
    subject: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    """Of the bundle, see :func:`subject_of`."""
    mode: Name
    """``fresh``, ``random`` or ``pairs`` and their number: the masks that were attacked."""
    form: Annotated[str, Field(pattern=r"^(sealed|raw)$")]
    """In which embeddings left."""
    quick: bool
    """Few masks and light attackers: a look, not a proof."""
    data: Line
    seed: int
    made_at: datetime
    minutes: Annotated[float, Field(ge=0, allow_inf_nan=False)]
    """Of the processor, all rows together."""
    rows: Annotated[tuple[CardRow, ...], Field(max_length=MAX_ROWS)]

    @property
    def void(self) -> bool:
        """True where the attacks failed even with the key: then no row says anything."""
        return not any(row.threat == "T0" and row.outcome == "PASS" for row in self.rows)

    @property
    def outcome(self) -> Literal["PASS", "FAIL", "NOT CLAIMED", "VOID"]:
        """True where all that is claimed held, if anything is."""
        if self.void:
            return "VOID"
        claimed = {row.outcome for row in self.rows if row.threat != "T0"} - {"NOT CLAIMED"}
        if not claimed:
            return "NOT CLAIMED"
        return "FAIL" if "FAIL" in claimed else "PASS"


def subject_of(manifest: bytes) -> str:
    """Return the digest that a card is bound to: SHA-256 of ``bundle.json`` less the card's own.

    ``bundle.json`` holds geometry, and the digests of masks, weights and statistics.
    """
    content = json.loads(manifest)
    parts = content.get("parts")
    if isinstance(parts, dict):
        parts.pop(CARD, None)
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def dump_card(card: PrivacyCard) -> bytes:
    """Readable JSON."""
    return card.model_dump_json(indent=1).encode()


def load_card(data: bytes, subject: str) -> PrivacyCard | None:
    """Return the card of the bundle that is called ``subject``, or None for anything else."""
    try:
        card = PrivacyCard.model_validate_json(data)
    except ValidationError:
        return None
    return card if card.subject == subject else None
