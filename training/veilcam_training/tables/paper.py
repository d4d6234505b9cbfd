"""What the paper reports, by the names of our cells."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files


@dataclass(frozen=True)
class Paper:
    """Test accuracies [percent] and where they stand."""

    source: str
    accuracy: Mapping[str, float]


@cache
def load_paper() -> Paper:
    """The numbers of ``paper.json``."""
    content = json.loads((files(__package__) / "paper.json").read_text())
    return Paper(content["source"], content["accuracy"])
