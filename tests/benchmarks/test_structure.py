"""What is counted of the product: statements, docstrings apart, folders, tables of drivers."""

from __future__ import annotations

from benchmarks.structure import files_of_a_driver, statements

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
