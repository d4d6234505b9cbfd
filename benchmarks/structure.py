"""Files and functions of the product that one job enters.

    python -m benchmarks.structure fit --figures benchmarks/results/house.json

A job runs twice: what modules do as they are imported is over when the second run is counted.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import Annotated

import typer
from typer.testing import CliRunner

from benchmarks.figures import FiguresOption, record
from veilcam_training.cli.main import app as train

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("client", "server", "optics", "training")
Functions = set[tuple[Path, str]]


@contextmanager
def counted() -> Iterator[Functions]:
    """Yield the file and the name of each function of the product that is entered meanwhile."""
    entered: set[tuple[str, str]] = set()
    found: Functions = set()

    def enter(frame: FrameType, event: str, argument: object) -> None:  # noqa: ARG001 - a hook's
        if event == "call":
            entered.add((frame.f_code.co_filename, frame.f_code.co_qualname))

    threading.setprofile(enter)
    sys.setprofile(enter)
    try:
        yield found
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
        for name, function in entered:
            path = Path(name)
            if path.is_relative_to(ROOT) and path.relative_to(ROOT).parts[0] in PARTS:
                found.add((path.relative_to(ROOT), function))


def invoke(*words: str) -> None:
    """Run ``veilcam-train`` in this process."""
    result = CliRunner().invoke(train, words, catch_exceptions=False)
    assert result.exit_code == 0, result.output


def fit(folder: Path) -> Callable[[], None]:
    """Return a fit of own pictures."""
    invoke("draw", str(folder / "shapes"), "--count", "200")
    runs = iter(range(2))

    def run() -> None:
        out = folder / f"fitted-{next(runs)}"
        invoke("fit", "--data", str(folder / "shapes"), "--epochs", "1", "--out", str(out))

    return run


JOBS: Mapping[str, Callable[[Path], Callable[[], None]]] = {"fit": fit}


def main(
    jobs: Annotated[list[str], typer.Argument(help=f"Of {', '.join(JOBS)}.")],
    figures: FiguresOption = None,
) -> None:
    """Count what each job enters."""
    values: dict[str, float] = {}
    for name in jobs:
        with TemporaryDirectory() as folder:
            run = JOBS[name](Path(folder))
            run()
            with counted() as found:
                run()
        files = sorted({str(path) for path, _ in found})
        print(*files, sep="\n")
        values |= {f"files_{name}": len(files), f"functions_{name}": len(found)}
    print(values)
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
