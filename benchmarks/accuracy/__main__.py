"""Error against time of every optics method over its dials, as a table, JSON and charts.

python -m benchmarks.accuracy --out build/accuracy
"""

import warnings
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import torch
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from benchmarks.accuracy.chart import draw
from benchmarks.accuracy.field_job import FieldJob
from benchmarks.accuracy.measure import Job, measure
from benchmarks.accuracy.psf_job import PsfJob
from benchmarks.accuracy.report import Result, table, write_json
from benchmarks.accuracy.transfer_job import TransferJob


class JobName(StrEnum):
    """The jobs by name."""

    transfer = "transfer"
    psf = "psf"
    field = "field"
    all = "all"


def chosen(name: JobName, *, quick: bool) -> list[TransferJob | PsfJob | FieldJob]:
    """The job of that name, or all of them."""
    kinds: dict[JobName, type[TransferJob | PsfJob | FieldJob]] = {
        JobName.transfer: TransferJob,
        JobName.psf: PsfJob,
        JobName.field: FieldJob,
    }
    return [kind(quick=quick) for own, kind in kinds.items() if name in {own, JobName.all}]


def main(
    *,
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer settings, a coarser scene: under a minute.")
    ] = False,
    job: Annotated[JobName, typer.Option(help="Which job to run.")] = JobName.all,
    out: Annotated[Path, typer.Option(help="Folder for accuracy.json and accuracy.png.")] = Path(
        "build/accuracy"
    ),
    threads: Annotated[int, typer.Option(min=1, help="Threads of every method.")] = 1,
) -> None:
    """Measure error and time of every method over its dials, against a converged reference."""
    jobs = [kind.job() for kind in chosen(job, quick=quick)]
    run(jobs, quick=quick, out=out, threads=threads)


def run(jobs: Sequence[Job], *, quick: bool, out: Path, threads: int) -> None:
    """Measure every setting of ``jobs``, print them and write table and charts into ``out``."""
    console = Console()
    torch.set_num_threads(threads)
    out.mkdir(parents=True, exist_ok=True)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()
    with Progress(*columns, TimeElapsedColumn(), console=console, transient=True) as progress:
        results = [_measured(job, progress, budget=0.05 if quick else 2.0) for job in jobs]
    for result in results:
        console.print(table(result))
    write_json(out / "accuracy.json", results, quick=quick)
    draw(out / "accuracy.png", results)
    for result in results:
        draw(out / f"accuracy-{result.name}.png", [result])
    console.print(f"Written to {out}: accuracy.json, accuracy.png and one picture for each job")


def _measured(job: Job, progress: Progress, *, budget: float) -> Result:
    """Run a job setting by setting, and show how far it is."""
    bar = progress.add_task(f"{job.name}: reference", total=len(job.settings) + 1)
    reference = job.reference()
    progress.advance(bar)
    points = []
    for setting in job.settings:
        progress.update(bar, description=f"{job.name}: {setting.label}"[:70])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # other libraries' own
            points.append(measure(setting, reference, budget=budget))
        progress.advance(bar)
    progress.update(bar, description=job.name)
    return Result(job.name, job.title, points, job.skipped)


if __name__ == "__main__":
    typer.run(main)
