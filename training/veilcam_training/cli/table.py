"""``veilcam-train table`` runs cells of a table, ``veilcam-train report`` shows them."""

import re
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import torch
import typer
from rich.console import Console
from rich.progress import Progress

from veilcam_training.config.settings import Settings, load_settings
from veilcam_training.encoders import ENCODERS
from veilcam_training.encoders.registry import WITH_PSF
from veilcam_training.errors import TrainingError, require
from veilcam_training.experiments.executors import make_executor
from veilcam_training.experiments.grid import TABLES, Cell, Part, Place, Table, find_table
from veilcam_training.experiments.records import check_record
from veilcam_training.experiments.results import CellResult, load_results, record_cells
from veilcam_training.experiments.runner import CellRunner, run_cells
from veilcam_training.files import check_folder
from veilcam_training.trainer.callbacks import Callback, Epoch, make_progress
from veilcam_training.trainer.distributed import choose_device

console = Console()

Out = Annotated[
    Path | None, typer.Option("--out", help="Folder for report.html, report.md and pictures.")
]
Figures = Annotated[
    Path | None, typer.Option("--figures", help="Record to write test accuracies into.")
]
Names = Annotated[
    str | None, typer.Option(help="Only these of the table's, with commas between them.")
]


def table_command(
    name: Annotated[str, typer.Argument(help=f"One of {', '.join(TABLES)}.")],
    *,
    data: Annotated[Path, typer.Option("--data", help="Folder that holds the data set's files.")],
    work: Annotated[
        Path, typer.Option("--work", help="Folder of the cells: what is finished there is kept.")
    ],
    out: Out = None,
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
    figures: Figures = None,
) -> None:
    """Run a table of the paper, or a part of it, and report it beside the paper's numbers.

    A table that was broken off, even by kill -9, goes on where it was. The report and the figures
    are of every finished cell of the table in --work, whenever it was run.
    """
    table = find_table(name)
    check_folder("--work", work)
    _check_places(out, figures)
    until = None if budget is None else time.time() + parse_duration(budget)
    psfs = _psfs(psf or [])
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
    # Absolute paths, here and below: a worker may stand elsewhere.
    cells = [
        Cell(_settings(each, seed + repeat, psfs, recipe, epochs))
        for repeat in range(seeds)
        for each in places
    ]
    place = choose_device(device)
    torch.set_num_threads(1)  # as in every worker: a number does not depend on how many there are
    run_by = make_executor(workers, ray, gpus=int(place.type == "cuda"))
    with make_progress(console) as progress:
        bar = TableProgress(progress, table.name, len(cells))
        runner = CellRunner(data.resolve(), work.resolve(), place, until)
        if ray is None and workers in (None, 1):  # in this process, where it can be watched
            runner.observe = bar.observe
        for result, now in run_cells(cells, runner, run_by):
            bar.finish(result, now=now)
    if bar.finished < len(cells):
        console.print(
            f"{len(cells) - bar.finished} of {len(cells)} cells are left: start again to go on"
        )
    _report(table, work, out, figures)


def report_command(
    name: Annotated[str, typer.Argument(help=f"One of {', '.join(TABLES)}.")],
    *,
    work: Annotated[Path, typer.Option("--work", help="Folder of the cells.")],
    out: Out = None,
    figures: Figures = None,
) -> None:
    """Report every finished cell of a table, whatever its settings; nothing is run."""
    require(work.is_dir(), f"{work} is not a folder: give that of the cells as --work")
    if out is None and figures is None:
        raise TrainingError("there is nowhere to report to: give --out FOLDER or --figures FILE")
    _check_places(out, figures)
    _report(find_table(name), work, out, figures)


def _check_places(out: Path | None, figures: Path | None) -> None:
    if out is not None:
        check_folder("--out", out)
    if figures is not None:
        check_record(figures)


def _report(table: Table, work: Path, out: Path | None, figures: Path | None) -> None:
    results = [result for result in load_results(work) if table.holds(result.settings)]
    if figures is not None:
        record_cells(figures, results)
    if out is not None:
        from veilcam_training.experiments.report import write_report  # noqa: PLC0415 - slow to import

        write_report(out, table, results, work)
        console.print(f"wrote {out / 'report.html'} and report.md: {len(results)} cells")


class TableProgress:
    """One bar for a table, and a line above it for each cell that was run."""

    def __init__(self, progress: Progress, name: str, cells: int) -> None:
        self._progress, self.finished = progress, 0
        self._bar = progress.add_task(name, total=cells, note="")

    def finish(self, result: CellResult, *, now: bool) -> None:
        """Count a cell; ``now`` if it was run by this command."""
        self.finished += 1
        self._progress.update(self._bar, completed=self.finished, note="")
        if now:
            self._progress.console.print(
                f"{result.cell.name}  validation {100 * result.validation_accuracy:.2f} %  "
                f"test {100 * result.test_accuracy:.2f} %{_beside(result)}  "
                f"{len(result.epochs)} epochs  {result.seconds:.0f} s",
                highlight=False,
                soft_wrap=True,
            )

    def observe(self, cell: Cell) -> Sequence[Callback]:
        """Watch ``cell`` being run."""
        return (_CellProgress(self, cell),)

    def note(self, text: str, share: float) -> None:
        """Say where a cell stands, of which ``share`` is done."""
        self._progress.update(self._bar, completed=self.finished + share, note=text)


class _CellProgress:
    """Shows one cell in the bar of its table."""

    def __init__(self, table: TableProgress, cell: Cell) -> None:
        self._table, self._cell = table, cell
        self._accuracy = ""

    def step(self, epoch: int, done: int, steps: int) -> None:
        epochs = self._cell.settings.recipe.epochs
        text = f"{self._cell.name}  epoch {epoch + 1} of {epochs}{self._accuracy}"
        self._table.note(text, (epoch + done / steps) / epochs)

    def epoch(self, epoch: Epoch) -> None:
        self._accuracy = f"  {100 * epoch.validation_accuracy:.2f} %"


def parse_duration(text: str) -> float:
    """Seconds in e.g. ``90s``, ``10m`` or ``2h``.

    Raises:
        TrainingError: not of that form.
    """
    match = re.fullmatch(r"(\d{1,6}(?:\.\d{1,3})?)([smh])", text)
    if match is None:
        raise TrainingError(f"--budget {text!r} is not valid: use e.g. 90s, 10m or 2h")
    return float(match[1]) * {"s": 1, "m": 60, "h": 3600}[match[2]]


def _beside(result: CellResult) -> str:
    paper = result.cell.place.paper
    return "" if paper is None else f" (paper {paper:.1f})"


def _names(text: str | None) -> list[str] | None:
    """The names in a list with commas."""
    return None if text is None else [name.strip() for name in text.split(",")]


def _psfs(given: Sequence[str]) -> dict[str, Path]:
    """Files of measured PSFs, by the encoder that each is of."""
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
    place: Place, seed: int, psfs: Mapping[str, Path], recipe: str, epochs: int | None
) -> Settings:
    chosen: dict[str, object] = {"base": recipe}
    if epochs is not None:
        chosen["epochs"] = epochs
    values: dict[str, object] = {
        **place.row._asdict(),
        **place.column._asdict(),
        "seed": seed,
        "recipe": chosen,
    }
    if place.row.encoder in psfs:
        values["psf"] = psfs[place.row.encoder]
    return load_settings(None, values)
