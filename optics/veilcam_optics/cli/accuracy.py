"""``veilcam-optics accuracy``: run every method on the jobs and show what accuracy costs."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import torch
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from veilcam_optics.accuracy.chart import draw
from veilcam_optics.accuracy.field_job import FieldJob
from veilcam_optics.accuracy.measure import Job, Setting, measure
from veilcam_optics.accuracy.peers import PEERS
from veilcam_optics.accuracy.psf_job import PsfJob
from veilcam_optics.accuracy.report import Result, table, write_json
from veilcam_optics.accuracy.transfer_job import TransferJob, plan_settings


class JobName(StrEnum):
    """The jobs by name."""

    transfer = "transfer"
    psf = "psf"
    field = "field"
    all = "all"


def collect(name: JobName, *, quick: bool) -> Iterator[Job]:
    """The chosen jobs with the settings of every library that is installed."""
    peers = [peer for peer in PEERS if not peer.missing()]
    if name in {JobName.transfer, JobName.all}:
        transfer = TransferJob(quick=quick)
        yield _joined(
            transfer.job(),
            plan_settings(transfer),
            *(peer.transfer(transfer) for peer in peers),
        )
    if name in {JobName.psf, JobName.all}:
        psf = PsfJob(quick=quick)
        yield _joined(psf.job(), *(peer.psf(psf) for peer in peers))
    if name in {JobName.field, JobName.all}:
        field = FieldJob(quick=quick)
        yield _joined(field.job(), *(peer.field(field) for peer in peers))


def _joined(job: Job, *more: Iterator[Setting]) -> Job:
    settings = [*job.settings, *(setting for some in more for setting in some)]
    return Job(job.name, job.title, job.reference, settings, job.skipped)


def accuracy(
    *,
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer settings, a coarser scene: under a minute.")
    ] = False,
    job: Annotated[JobName, typer.Option(help="Which job to run.")] = JobName.all,
    out: Annotated[Path, typer.Option(help="Folder for accuracy.json and accuracy.png.")] = Path(
        "accuracy"
    ),
    threads: Annotated[int, typer.Option(min=1, help="Threads of every method.")] = 1,
) -> None:
    """Measure error and time of every method over its dials, against a converged reference."""
    console = Console()
    torch.set_num_threads(threads)
    out.mkdir(parents=True, exist_ok=True)
    for peer in PEERS:
        if reason := peer.missing():
            # Brackets in it are no markup.
            text = f"{peer.name} is not in the comparison: {reason}"
            console.print(text, style="dim", markup=False, soft_wrap=True)
    results = []
    with _progress(console) as progress:
        for chosen in collect(job, quick=quick):
            bar = progress.add_task(f"{chosen.name}: reference", total=len(chosen.settings) + 1)
            reference = chosen.reference()
            progress.advance(bar)
            points = []
            for setting in chosen.settings:
                progress.update(bar, description=f"{chosen.name}: {setting.label}"[:70])
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # peers' own
                    points.append(
                        measure(
                            setting,
                            reference,
                            budget=0.05 if quick else 2.0,
                        )
                    )
                progress.advance(bar)
            progress.update(bar, description=chosen.name)
            results.append(Result(chosen.name, chosen.title, points, chosen.skipped))
    for result in results:
        console.print(table(result))
    write_json(out / "accuracy.json", results, quick=quick)
    draw(out / "accuracy.png", results)
    for result in results:
        draw(out / f"accuracy-{result.name}.png", [result])
    console.print(f"Written to {out}: accuracy.json, accuracy.png and one picture for each job")


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
    )
