"""Accuracy of the demonstration, kept as a figure.

    python -m benchmarks.daemon.demo --figures benchmarks/results/main-job.json

As ``veilcamd demo``: a daemon in a process of its own, and held-out digits through changing masks.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from benchmarks.figures import FiguresOption, check_record, record
from rich.console import Console

from veilcam_server.demo.run import Plan, demonstrate


def main(
    *,
    captures: Annotated[int, typer.Option(min=1, help="How many digits to show.")] = 250,
    fresh: Annotated[bool, typer.Option("--fresh", help="Draw every mask from a key.")] = False,
    wrong_classifier: Annotated[
        bool, typer.Option("--wrong-classifier", help="Read every mask as if it were another one.")
    ] = False,
    bundle: Annotated[
        Path | None, typer.Option(help="Masks and classifiers; those that come along by default.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Directory for report.png.")] = Path("demo"),
    figures: FiguresOption = None,
) -> None:
    """Run the demonstration and keep its accuracy."""
    if figures is not None:
        check_record(figures)
    plan = Plan(
        fresh=fresh, bundle=bundle, out=out, captures=captures, wrong_classifier=wrong_classifier
    )
    tally = demonstrate(plan, Console())
    print(tally.summary())
    kinds = ("fresh", fresh), ("wrong_classifier", wrong_classifier)
    name = "_".join(("demo", *(kind for kind, it_is in kinds if it_is), "accuracy"))
    record(figures, {name: round(tally.accuracy, 4)})


if __name__ == "__main__":
    typer.run(main)
