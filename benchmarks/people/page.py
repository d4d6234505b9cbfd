"""The page in Chromium: tests that passed, what axe-core found, and what was asked of others.

python -m benchmarks.people.page --figures benchmarks/results/people.json
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import pytest
import typer
from benchmarks.figures import FiguresOption, record

TESTS = Path(__file__).resolve().parents[2] / "tests" / "page"


@dataclass
class Tally:
    """Counts what the tests of the page tell of themselves."""

    passed: int = 0
    figures: dict[str, int] = field(
        default_factory=lambda: {"axe_violations": 0, "outside_requests": 0}
    )

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add what one test found, once."""
        if report.when == "call":
            self.passed += report.passed
        elif report.when == "teardown":
            for name, value in report.user_properties:
                if name in self.figures and isinstance(value, int):
                    self.figures[name] += value


def main(*, figures: FiguresOption = None) -> None:
    """Run the tests of the page; status 1 if one fails."""
    tally = Tally()
    status = pytest.main(["-q", "-m", "page", str(TESTS)], plugins=[tally])
    for name, value in {"page_tests": tally.passed, **tally.figures}.items():
        typer.echo(f"{name}: {value}")
    record(figures, {"page_tests": tally.passed, **tally.figures})
    raise SystemExit(int(status))


if __name__ == "__main__":
    typer.run(main)
