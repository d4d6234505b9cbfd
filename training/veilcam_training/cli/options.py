"""Options that several commands have, and what they do before and around a fit."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, TypeVar

import torch
import typer
from rich.console import Console
from rich.table import Table

from veilcam_training.config.settings import FreshSettings, Settings
from veilcam_training.data import Source, open_source
from veilcam_training.data.summary import summarise
from veilcam_training.errors import require
from veilcam_training.files import check_file, check_folder
from veilcam_training.trainer.callbacks import (
    Callback,
    CsvLog,
    FitProgress,
    TensorBoardLog,
    make_progress,
)

Folder = Annotated[Path, typer.Option("--data", help="Folder that holds the data set's files.")]
Config = Annotated[
    Path | None, typer.Option("--config", help="TOML file of settings; options go before it.")
]
Epochs = Annotated[int | None, typer.Option("--epochs", help="Instead of what the settings say.")]
Batch = Annotated[int | None, typer.Option("--batch", help="Instead of what the settings say.")]
Seed = Annotated[
    int | None,
    typer.Option(
        "--seed",
        help="Of every random number, to get the same masks again, as whoever knows it can: "
        "leave it out for masks that go on a camera, then a secret one is drawn.",
    ),
]
Work = Annotated[
    Path | None, typer.Option("--work", help="Folder for checkpoints: resumes what is in it.")
]
Logs = Annotated[Path | None, typer.Option("--tensorboard", help="Folder for TensorBoard's logs.")]
Csv = Annotated[Path | None, typer.Option("--csv", help="File of accuracies and losses, *.csv.")]
Device = Annotated[str, typer.Option("--device", help="cpu, cuda, or auto: cuda if there is one.")]
Threads = Annotated[
    int | None,
    typer.Option("--threads", min=1, help="Instead of OMP_NUM_THREADS, which is 1 unless set."),
]
SkipDamaged = Annotated[
    bool, typer.Option("--skip-damaged", help="Go on without own pictures that cannot be read.")
]


def given(**options: object) -> dict[str, object]:
    """Those options that were given."""
    return {name: value for name, value in options.items() if value is not None}


def check_places(
    out: Path | None, work: Path | None, logs: Path | None = None, table: Path | None = None
) -> None:
    """Refuse places that cannot be written to, before the work."""
    if out is not None:
        check_file("--out", out, ".veilcam")
    if work is not None:
        check_folder("--work", work)
    if logs is not None:
        check_folder("--tensorboard", logs)
    if table is not None:
        check_file("--csv", table, ".csv")


def prepare(device: str, threads: int | None) -> torch.device:
    """Set the number of threads and choose the device."""
    if threads is not None:
        torch.set_num_threads(threads)
    return choose_device(device)


def choose_device(name: str) -> torch.device:
    """Return the device called ``name``: cpu, cuda, or auto for cuda if there is one.

    Raises:
        TrainingError: an unknown name, or CUDA where there is none.
    """
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    require(name in ("cpu", "cuda"), f"--device {name} is not valid: use cpu, cuda or auto")
    require(
        name != "cuda" or torch.cuda.is_available(),
        "--device cuda is not valid: torch sees no CUDA device; use cpu",
    )
    return torch.device(name)


SettingsT = TypeVar("SettingsT", Settings, FreshSettings)


def opened(
    load: Callable[..., SettingsT], folder: Path, *, skip_damaged: bool
) -> tuple[SettingsT, Source]:
    """Return the settings of a fit and its data set.

    Args:
        load: function that loads settings, and is told whether the data set has ``colour``.
        folder: folder of the data set.
        skip_damaged: leave out own pictures that cannot be read.
    """
    settings = load(colour=False)
    source = open_source(settings.data, folder, skip_damaged=skip_damaged)
    if source.colour:
        settings = load(colour=True)
    return settings, source


def show_summary(console: Console, source: Source) -> None:
    """Print what ``source`` holds; raises TrainingError where it cannot be read."""
    summary = summarise(source)
    table = Table("class", "training", "test", title=f"{source.name}: {summary.form}")
    for label, training, test in zip(source.labels, summary.training, summary.test, strict=True):
        table.add_row(label, f"{training}", f"{test}")
    console.print(table)
    for warning in summary.warnings:
        console.print(f"warning: {warning}", markup=False, highlight=False, soft_wrap=True)


@contextmanager
def watch(
    console: Console,
    name: str,
    epochs: int,
    *,
    logs: Path | None,
    table: Path | None,
) -> Iterator[Sequence[Callback]]:
    """Yield the callbacks of a fit, which show it while it lasts."""
    with make_progress(console) as progress:
        callbacks: list[Callback] = [FitProgress(progress, name, epochs)]
        if logs is not None:
            callbacks.append(TensorBoardLog(logs))
        if table is not None:
            callbacks.append(CsvLog(table))
        yield callbacks
