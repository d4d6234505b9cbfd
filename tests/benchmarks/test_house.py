"""Costs of a command, and counts of the product."""

from __future__ import annotations

import subprocess
import sys

import pytest
from benchmarks import house
from benchmarks.structure import files_of_a_driver, statements

WORK = """
from resource import RUSAGE_SELF, getrusage
while getrusage(RUSAGE_SELF).ru_utime < 0.2: pass
"""


def test_cost_counts_children_of_a_command() -> None:
    in_a_child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {WORK!r}])"
    _, used = house.cost([sys.executable, "-c", in_a_child])
    assert used >= 0.2


def test_cost_of_a_command_that_fails_is_refused() -> None:
    with pytest.raises(subprocess.CalledProcessError):
        house.cost([sys.executable, "-c", "raise SystemExit(1)"])


SOURCE = '''"""A module."""

import os

SIZE = 3
"""A constant."""


def area(side: int) -> int:
    """Square."""
    if side:
        return side * side
    return 0
'''


def test_statements_and_docstrings_are_counted_apart() -> None:
    # import, assignment, def, if and two returns; three docstrings
    assert statements([SOURCE, ""]) == (6, 3)


def test_driver_is_its_file_and_its_entries_in_tables() -> None:
    line = "DRIVERS = (\n    st7735r.DRIVER,\n)\n"
    other = "display = st7735r.DRIVER\n"
    assert files_of_a_driver({"registry.py": line, "panel.py": other}) == 2
