"""Options that several commands have, and what they do before and around a fit."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import torch
import typer
from rich.console import Console
from rich.table import Table

from veilcam_training.data import Source
from veilcam_training.data.summary import summarise
from veilcam_training.files import check_file, check_folder
from veilcam_training.trainer.callbacks import (
    Callback,
    CsvLog,
    FitProgress,
    TensorBoardLog,
    make_progress,
)
from veilcam_training.trainer.distributed import Ranks, choose_device, has_bfloat16

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


def show_summary(console: Console, source: Source) -> None:
    """Print what ``source`` holds; raises TrainingError where it cannot be read."""
    summary = summarise(source)
    table = Table("class", "training", "test", title=f"{source.name}: {summary.form}")
    for label, training, test in zip(source.labels, summary.training, summary.test, strict=True):
        table.add_row(label, f"{training}", f"{test}")
    console.print(table)
    for warning in summary.warnings:
        console.print(f"warning: {warning}", markup=False, highlight=False, soft_wrap=True)


def warn_of_precision(console: Console, device: torch.device, *, mixed: bool, instead: str) -> None:
    """Say that a fit in mixed precision is to run where bfloat16 is emulated.

    Args:
        console: to print on.
        device: that fits.
        mixed: whether the fit is in mixed precision.
        instead: the setting that takes full precision, as in a file.
    """
    if mixed and not has_bfloat16(device):
        console.print(
            f"warning: this processor emulates bfloat16, which is slow: use {instead}, unless "
            "the numbers of another machine are to come out",
            markup=False,
            soft_wrap=True,
        )


@contextmanager
def watch(
    console: Console,
    name: str,
    epochs: int,
    ranks: Ranks,
    *,
    logs: Path | None,
    table: Path | None,
) -> Iterator[Sequence[Callback]]:
    """Callbacks of a fit, shown by the first rank alone while it lasts."""
    with make_progress(console if ranks.is_first else Console(quiet=True)) as progress:
        callbacks: list[Callback] = []
        if ranks.is_first:
            callbacks.append(FitProgress(progress, name, epochs))
            if logs is not None:
                callbacks.append(TensorBoardLog(logs))
            if table is not None:
                callbacks.append(CsvLog(table))
        yield callbacks
