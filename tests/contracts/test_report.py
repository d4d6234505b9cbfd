"""docs/stability.md says what the registry says."""

from __future__ import annotations

import pytest

from .report import CLOSED_FORMS, DEFECTS, PAGE, TESTS, blank, named_tests, render, without_numbers


def test_page_is_not_stale() -> None:
    """Operators, contracts, tolerances and cases; the measured numbers depend on the machine."""
    written = without_numbers(PAGE.read_text()).splitlines()
    current = render(blank).splitlines()
    assert written == current, "run python -m tests.contracts.report"


@pytest.mark.thorough
@pytest.mark.parametrize(
    "place", [place for table in (CLOSED_FORMS, DEFECTS) for t in table.values() for place in t]
)
def test_every_test_that_the_page_names_exists(place: str) -> None:
    file, name = place.split("::")
    assert name in named_tests(TESTS / file)
