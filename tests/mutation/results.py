"""Results of mutants, kept as they come: one line of JSON each."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from .operators import Mutant

Outcome: TypeAlias = Literal["survived", "killed", "timeout"]


@dataclass(frozen=True, slots=True)
class Result:
    """What became of a mutant."""

    tree: str
    """Digest of the repository that it was tried in."""
    subject: str
    mutant: Mutant
    outcome: Outcome


def append_result(path: Path, result: Result) -> None:
    """Add a line to the file of results."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as stream:
        stream.write(f"{json.dumps(asdict(result))}\n")


def read_results(path: Path, tree: str) -> list[Result]:
    """Results that hold for a repository; a line that was cut short is left out."""
    results = []
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            entry = json.loads(line)
        except json.JSONDecodeError:
            continue
        if entry["tree"] == tree:
            results.append(Result(**{**entry, "mutant": Mutant(**entry["mutant"])}))
    return results
