"""The paper's tables, and ours of the same kind, reported beside the paper's numbers.

    python -m benchmarks.paper mnist --data data/mnist --work runs/mnist --out report

Finished cells are kept in ``--work``. A table that was broken off, even by kill -9, goes on where
it was; with ``--budget 0s`` nothing is run, and what is finished is reported.
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import torch
import typer

from benchmarks.figures import FiguresOption, check_record
from benchmarks.paper.grid import TABLES, Cell, Part, Place, Table, find_table
from benchmarks.paper.report import write_report
from benchmarks.paper.results import CellResult, load_results, record_cells
from benchmarks.paper.runner import CellRunner, run_cells
from veilcam_training.bundle import BundleError
from veilcam_training.cli.options import choose_device
from veilcam_training.config.files import load_settings
from veilcam_training.config.settings import FitSettings
from veilcam_training.encoders import ENCODERS
from veilcam_training.encoders.registry import WITH_PSF
from veilcam_training.errors import TrainingError, require
from veilcam_training.experiments.executors import make_executor
from veilcam_training.files import check_folder

Names = Annotated[
    str | None, typer.Option(help="Only these of the table's, with commas between them.")
]


def command(
    name: Annotated[str, typer.Argument(help=f"One of {', '.join(TABLES)}.")],
    *,
    data: Annotated[Path, typer.Option(help="Folder that holds the data set's files.")],
    work: Annotated[Path, typer.Option(help="Folder of the cells: what is finished is kept.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for report.html and its pictures.")
    ] = None,
    encoders: Names = None,
    classifiers: Annotated[
        str | None, typer.Option(help="Instead of the paper's, e.g. LR,CNN32.")
    ] = None,
    embeddings: Names = None,
    binnings: Annotated[
        str | None, typer.Option(help="area, point or both; point for learned masks by default.")
    ] = None,
    datasets: Names = None,
    changes: Names = None,
    seeds: Annotated[int, typer.Option(min=1, help="Repeat every cell with so many seeds.")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="The first of them.")] = 0,
    recipe: Annotated[str, typer.Option(help="By name, as of fit.")] = "default",
    epochs: Annotated[int | None, typer.Option(help="Instead of the recipe's.")] = None,
    noise: Annotated[
        str | None, typer.Option(help="photons: of an exposure at full well; else 40 dB.")
    ] = None,
    psf: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[ENCODER=]FILE",
            help="Measured PSF (.npz) of fixed_measured, or of the encoder that is named; "
            "may be repeated.",
        ),
    ] = None,
    budget: Annotated[
        str | None, typer.Option(help="Begin no cell after this time, e.g. 90s, 10m, 2h.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Cells at a time, one thread each; 1 by default.")
    ] = None,
    ray: Annotated[
        str | None, typer.Option(help="HOST:PORT of a Ray cluster, or local to start one.")
    ] = None,
    device: Annotated[str, typer.Option(help="cpu, cuda, or auto: cuda if there is one.")] = "auto",
    quick: Annotated[
        bool, typer.Option("--quick", help="One epoch, the smallest embedding, one classifier.")
    ] = False,
    figures: FiguresOption = None,
) -> None:
    """Run a table of the paper, or a part of it, and report it beside the paper's numbers.

    The report and the figures are of every finished cell of the table in --work, whenever it was
    run.
    """
    table = find_table(name)
    check_folder("--work", work)
    if out is not None:
        check_folder("--out", out)
    if figures is not None:
        check_record(figures)
    until = None if budget is None else time.time() + parse_duration(budget)
    psfs = _psfs(psf or [])
    if quick:
        epochs, embeddings = 1, table.embeddings[-1]
        classifiers = classifiers or table.classifiers[0]
    part = Part(
        encoders=_names(encoders),
        classifiers=_names(classifiers),
        embeddings=_names(embeddings),
        binnings=_names(binnings),
        datasets=_names(datasets),
        changes=_names(changes),
    )
    places = table.places(part, psf="fixed_measured" in psfs)
    for encoder in psfs:
        require(
            any(each.row.encoder == encoder for each in places),
            f"--psf is of {encoder}, which --encoders leaves out: drop either",
        )
    asked = {"recipe": recipe, "epochs": epochs, "snr_db": noise}
    chosen = {name: value for name, value in asked.items() if value is not None}
    # Absolute paths, here and below: a worker may stand elsewhere.
    cells = [
        Cell(_settings(each, seed + repeat, psfs, chosen))
        for repeat in range(seeds)
        for each in places
    ]
    place = choose_device(device)
    torch.set_num_threads(1)  # as in every worker: a number does not depend on how many there are
    runner = CellRunner(data.resolve(), work.resolve(), place, until)
    run_by = make_executor(workers, ray, gpus=int(place.type == "cuda"))
    finished = 0
    for finished, (result, now) in enumerate(run_cells(cells, runner, run_by), start=1):
        if now:
            print(f"{finished} of {len(cells)}  {_in_words(result)}", flush=True)
    if finished < len(cells):
        print(f"{len(cells) - finished} of {len(cells)} cells are left: start again to go on")
    _report(table, work, out, figures)


def _report(table: Table, work: Path, out: Path | None, figures: Path | None) -> None:
    results = [result for result in load_results(work) if table.holds(result.settings)]
    if figures is not None:
        record_cells(figures, results)
    if out is not None:
        write_report(out, table, results, work)
        print(f"wrote {out / 'report.html'}: {len(results)} cells")


def parse_duration(text: str) -> float:
    """Return the seconds in e.g. ``90s``, ``10m`` or ``2h``.

    Raises:
        TrainingError: not of that form.
    """
    match = re.fullmatch(r"(\d{1,6}(?:\.\d{1,3})?)([smh])", text)
    if match is None:
        raise TrainingError(f"--budget {text!r} is not valid: use e.g. 90s, 10m or 2h")
    return float(match[1]) * {"s": 1, "m": 60, "h": 3600}[match[2]]


def _in_words(result: CellResult) -> str:
    paper = result.cell.place.paper
    return (
        f"{result.cell.name}  validation {100 * result.validation_accuracy:.2f} %  "
        f"test {100 * result.test_accuracy:.2f} %{'' if paper is None else f' (paper {paper:.1f})'}"
        f"  {len(result.epochs)} epochs  {result.seconds:.0f} s"
    )


def _names(text: str | None) -> list[str] | None:
    """Return the names in a list with commas."""
    return None if text is None else [name.strip() for name in text.split(",")]


def _psfs(given: Sequence[str]) -> dict[str, Path]:
    """Return the files of measured PSFs, by the encoder that each is of."""
    found: dict[str, Path] = {}
    for each in given:
        name, equals, rest = each.partition("=")
        named = bool(equals) and name in ENCODERS
        encoder, path = (name, Path(rest)) if named else ("fixed_measured", Path(each))
        require(encoder in WITH_PSF, f"encoder {encoder!r} takes no PSF: leave out --psf {each}")
        require(encoder not in found, f"--psf is given twice for {encoder}: drop one")
        require(path.is_file(), f"{path} is missing: give the file of a PSF as --psf")
        found[encoder] = path.resolve()
    return found


def _settings(
    place: Place, seed: int, psfs: Mapping[str, Path], chosen: Mapping[str, object]
) -> FitSettings:
    row = place.row
    values: dict[str, object] = {
        "classifier": row.classifier,
        **place.column._asdict(),
        "seed": seed,
        "hidden": row.encoder == "hidden",
        **chosen,
    }
    if row.encoder == "fresh":
        values["fresh"] = {}
    else:
        encoder = "learned" if row.encoder == "hidden" else row.encoder
        values |= {"encoder": encoder, "binning": row.binning}
    if row.encoder in psfs:
        values["psf"] = psfs[row.encoder]
    return load_settings(None, values, colour=place.column.data == "cifar10")


app = typer.Typer(pretty_exceptions_enable=False)
app.command()(command)

if __name__ == "__main__":
    try:
        app()
    except (TrainingError, BundleError) as error:
        sys.exit(f"error: {error}")
