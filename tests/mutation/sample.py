"""Seeded sample of mutants, and the list of those that no test can tell from the original."""

from __future__ import annotations

import random
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from .operators import Mutant, find_mutants
from .subjects import Subject

EQUIVALENT = Path(__file__).with_name("equivalent.toml")


@dataclass(frozen=True, slots=True)
class Equivalent:
    """A mutant that does what the original does; fields as :class:`Mutant` has them."""

    file: str
    before: str
    after: str
    reason: str

    def __post_init__(self) -> None:
        if not self.reason.strip():
            raise ValueError(f"{self.file}: {self.after!r} is called equivalent without a reason")

    def matches(self, mutant: Mutant) -> bool:
        """Whether this is that mutant, wherever its line stands in the file."""
        return (self.file, self.before, self.after) == (mutant.file, mutant.before, mutant.after)


def read_equivalents(path: Path = EQUIVALENT) -> list[Equivalent]:
    """Read the list.

    Raises:
        ValueError: an entry without a reason.
        TypeError: an entry that lacks a field, or has an unknown one.
    """
    table = tomllib.loads(path.read_text())
    return [Equivalent(**entry) for entry in table.get("equivalent", [])]


def mutants_of(subject: Subject, root: Path) -> list[Mutant]:
    """All mutants of a subject's sources under ``root``."""
    return [
        mutant
        for file in subject.sources
        for mutant in find_mutants(file, (root / file).read_text())
    ]


def draw(
    found: Mapping[Subject, Sequence[Mutant]], count: int, seed: int
) -> dict[Subject, list[Mutant]]:
    """Draw ``count`` mutants, as evenly over the subjects as these have them.

    Args:
        found: all mutants.
        count: of all subjects together.
        seed: the same one draws the same mutants.
    """
    shares = dict.fromkeys(found, 0)
    while count > 0 and (able := [each for each in found if shares[each] < len(found[each])]):
        for subject in able[:count]:
            shares[subject] += 1
            count -= 1
    drawn = {}
    for subject, mutants in found.items():
        # Each subject by a generator of its own: a change of one does not draw all others anew.
        chosen = random.Random(f"{seed} {subject.name}").sample(mutants, shares[subject])
        drawn[subject] = sorted(chosen, key=lambda mutant: (mutant.file, mutant.start))
    return drawn
