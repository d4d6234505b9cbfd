"""docs/stability.md says what the registry says."""

from __future__ import annotations

from .report import PAGE, blank, render, without_numbers


def test_page_is_not_stale() -> None:
    """Operators, contracts, tolerances, cases; the numbers depend on the machine."""
    written = without_numbers(PAGE.read_text()).splitlines()
    current = render(blank).splitlines()
    assert written == current, "run python -m tests.contracts.report"
