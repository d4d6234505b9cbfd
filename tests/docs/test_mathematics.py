"""The page of the mathematics numbers its equations, and the code cites none that is not there."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "mathematics.md").read_text()
NUMBER = re.compile(r" {6}\((\d+)\)$", re.MULTILINE)
CITED = re.compile(r"equation\s+\((\d+)\)")
NAMED = re.compile(r"\((\d+)\)")


def test_its_equations_are_numbered_in_order() -> None:
    numbers = [int(number) for number in NUMBER.findall(PAGE)]
    assert len(numbers) >= 10
    assert numbers == list(range(1, len(numbers) + 1))


def test_every_number_that_it_names_is_there() -> None:
    text = "\n".join(line for line in PAGE.splitlines() if not line.startswith("    "))
    assert set(NAMED.findall(text)) <= set(NUMBER.findall(PAGE))


def test_every_equation_that_the_code_cites_is_there() -> None:
    cited = {
        path: CITED.findall(path.read_text())
        for path in (ROOT / "optics" / "veilcam_optics").rglob("*.py")
    }
    numbers = set(NUMBER.findall(PAGE))
    assert sum(map(len, cited.values())) >= 6
    for path, found in cited.items():
        assert set(found) <= numbers, path
