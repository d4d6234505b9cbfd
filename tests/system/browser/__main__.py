"""What the requests of a page of another site do, in a real browser.

python -m tests.system.browser --figures benchmarks/results/siege.json
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import typer
from benchmarks.figures import FiguresOption, record
from tests.system.browser.asks import asks
from tests.system.browser.foreign_page import browser
from tests.system.browser.trials import TRIALS, daemon, try_page, try_program


def main(*, figures: FiguresOption = None) -> None:
    """Let the page ask daemons of their own, then a program the same; status 1 if a page acts."""
    program = browser()
    if program is None:
        raise typer.BadParameter("there is no Chromium: on Debian, apt install chromium")
    acted: list[str] = []
    with TemporaryDirectory() as name:
        folder = Path(name)
        for number, (title, trial) in enumerate(TRIALS.items()):
            with daemon(folder / f"daemon-{number}", trial.auth) as watched:
                result = try_page(program, folder / f"page-{number}", trial, asks(), watched)
                idle = try_program(asks(), watched)
            acted += result.acted
            typer.echo(
                f"{title}: {len(result.acted)} of {len(result.learned)} requests of the page did "
                f"anything; {len(asks()) - len(idle)} of {len(asks())} of a program did"
            )
            if idle:
                raise SystemExit(f"these show nothing, for a program's do nothing: {idle}")
    record(figures, {"foreign_page_actions": len(acted)})
    if acted:
        raise SystemExit(1)


if __name__ == "__main__":
    typer.run(main)
