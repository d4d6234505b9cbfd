"""Labels: names of classes that every reader of a bundle can show and tell apart."""

import unicodedata
from collections.abc import Sequence

MAX_LABELS = 1024
LONGEST = 64
"""Of a label [characters]."""
RESERVED = ("nothing", "none", "unknown", "unavailable")
"""Words of the camera and of Home Assistant for a label that is not there, in small letters."""
_JOINERS = "\u200c\u200d"
"""Format characters that belong to the spelling of some languages and to emoji."""


def labels_fault(labels: Sequence[str]) -> str | None:
    """Return why labels cannot be used, naming the first of them; None if they can."""
    if not 2 <= len(labels) <= MAX_LABELS:
        return f"there are {len(labels)} labels: use 2 to {MAX_LABELS}"
    known: set[str] = set()
    for label in labels:
        fault, composed = _fault(label), unicodedata.normalize("NFC", label)
        # A terminal may not show it as it is.
        if fault is not None:
            return f"label {label[:LONGEST]!a} {fault}: give it another name"
        if composed in known:
            return f"label {label!a} is there twice: use different names"
        known.add(composed)
    return None


def _fault(label: str) -> str | None:
    kinds = {unicodedata.category(each) for each in label if each not in _JOINERS}
    if "Cs" in kinds:
        return "is not valid UTF-8"
    if kinds & {"Cc", "Cf", "Zl", "Zp"}:
        return "holds control characters or such as change the direction of writing"
    if not label.strip():
        return "is empty"
    if len(label) > LONGEST:
        return f"has {len(label)} characters, more than {LONGEST}"
    if label.strip().casefold() in RESERVED:
        return "is the word for a camera that sees nothing, or knows nothing"
    return None
