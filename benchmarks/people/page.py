"""The page in Chromium: jobs that it does, what axe-core found, and looks that it shows.

python -m benchmarks.people.page --figures benchmarks/results/people.json
"""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import typer
from benchmarks.figures import FiguresOption, record
from playwright.sync_api import sync_playwright

TESTS = Path(__file__).resolve().parents[2] / "tests" / "page"
WIDTHS = 2
"""Widths at which a job is done."""
WATCH = "10/s"
"""Rate that no simulated camera keeps on two cores, so that asked and real differ."""
WINDOW = 60_000.0
"""Time over which the page counts looks [ms]."""
SETTLING = 5_000.0
"""Time after the page opens before looks are counted [ms]."""


@dataclass
class Tally:
    """Counts what the tests of the page tell of themselves."""

    passed: int = 0
    jobs: Counter[str] = field(default_factory=Counter)
    figures: dict[str, int] = field(
        default_factory=lambda: {"axe_violations": 0, "outside_requests": 0}
    )

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add what one test found, once."""
        if report.when == "call":
            self.passed += report.passed
        elif report.when == "teardown":
            for name, value in report.user_properties:
                if name == "page_job":
                    self.jobs[str(value)] += 1
                elif name in self.figures and isinstance(value, int):
                    self.figures[name] += value

    @property
    def jobs_done(self) -> int:
        """Number of jobs that were done at every width."""
        return sum(count == WIDTHS for count in self.jobs.values())


def looks_shown_over_real() -> float:
    """Return looks a second as the page shows them, over those that the daemon did."""
    # Late: pytest refuses to run where its own plugin's packages are there already.
    from veilcam_client import Camera  # noqa: PLC0415
    from veilcam_server.demo.daemon import running  # noqa: PLC0415
    from veilcam_server.demo_data import FRESH, load_digits  # noqa: PLC0415
    from veilcam_server.devices.simulated.scenes import write_scene  # noqa: PLC0415

    program = shutil.which("chromium")
    with tempfile.TemporaryDirectory() as place, sync_playwright() as playwright:
        folder = Path(place)
        write_scene(folder / "scene.npy", load_digits().images[0])
        browser = playwright.chromium.launch(
            executable_path=program, chromium_sandbox=False, args=["--disable-gpu"]
        )
        with (
            running(FRESH, folder / "scene.npy", folder, "--watch", WATCH) as url,
            Camera(url) as camera,
        ):
            page = browser.new_page()
            page.goto(url)
            rate = page.locator(".facts div", has_text="Looks a second").locator("dd")
            rate.wait_for()
            page.wait_for_timeout(SETTLING)
            before = camera.watch.get().looks
            page.wait_for_timeout(WINDOW)
            real = (camera.watch.get().looks - before) / (WINDOW / 1000)
            shown = float(rate.inner_text())
        browser.close()
    typer.echo(f"looks a second: {shown} shown, {real} real, {WATCH} asked for")
    return shown / real


def main(*, figures: FiguresOption = None) -> None:
    """Run the tests of the page; status 1 if one fails."""
    tally = Tally()
    status = pytest.main(["-q", "-m", "page", str(TESTS)], plugins=[tally])
    found = {
        "page_tests": tally.passed,
        "page_jobs_done": tally.jobs_done,
        **tally.figures,
        "looks_shown_over_real": round(looks_shown_over_real(), 2),
    }
    for name, value in found.items():
        typer.echo(f"{name}: {value}")
    record(figures, found)
    raise SystemExit(int(status))


if __name__ == "__main__":
    typer.run(main)
