"""docs/stability.md says what the registry says."""

from __future__ import annotations

from .report import CLOSED_FORMS, DEFECTS, PAGE, TESTS, blank, named_tests, render, without_numbers


def test_page_is_not_stale() -> None:
    """Operators, contracts, tolerances and cases; the measured numbers depend on the machine."""
    written = without_numbers(PAGE.read_text()).splitlines()
    current = render(blank).splitlines()
    assert written == current, "run python -m tests.contracts.report"


def test_tests_that_the_page_names_exist() -> None:
    places = {
        place for table in (CLOSED_FORMS, DEFECTS) for each in table.values() for place in each
    }
    for file in {place.split("::")[0] for place in places}:
        named = {place.split("::")[1] for place in places if place.startswith(f"{file}::")}
        assert named <= named_tests(TESTS / file).keys(), file
