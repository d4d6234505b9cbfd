"""Evidence as a test wants it."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from veilcam_server.masks.source import Evidence

LABELS = ("a", "b", "c")
SURE = 6.0
"""Logit of the class that a capture is sure of; the others' are 0."""

Look = Callable[..., Evidence]


@pytest.fixture
def look() -> Look:
    """A capture that tells of a label, or of nothing; nothing is what it looks like in the dark."""

    def make(label: str | None, *, light: float = 0.02, novelty: float | None = 1.0) -> Evidence:
        logits = tuple(SURE * (each == label) for each in LABELS)
        return Evidence(LABELS, logits, light if label else 0.0, novelty)

    return make
