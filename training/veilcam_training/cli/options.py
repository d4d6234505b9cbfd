"""Options that several commands have, and what they do before and around a fit."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import torch
import typer
from rich.console import Console
from rich.table import Table

from veilcam_training.config.recipes import RECIPES
from veilcam_training.config.settings import FitSettings
from veilcam_training.data import SOURCES, Source, open_source
from veilcam_training.data.summary import summarise
from veilcam_training.encoders import ENCODERS
from veilcam_training.errors import require
from veilcam_training.transforms.scene import TRANSFORMS

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
Device = Annotated[str, typer.Option("--device", help="cpu, cuda, or auto: cuda if there is one.")]
Threads = Annotated[
    int | None,
    typer.Option("--threads", min=1, help="Instead of OMP_NUM_THREADS, which is 1 unless set."),
]
SkipDamaged = Annotated[
    bool, typer.Option("--skip-damaged", help="Go on without own pictures that cannot be read.")
]

Dataset = Annotated[
    str | None,
    typer.Option(
        "--dataset",
        help=f"One of {', '.join(SOURCES)}; own pictures are found by themselves, else mnist.",
    ),
]
Classifier = Annotated[
    str | None,
    typer.Option("--classifier", help="LR, FC<width>, VGG11, CNN<width> or Scene<width>."),
]
EncoderName = Annotated[
    str | None, typer.Option("--encoder", help=f"One of {', '.join(ENCODERS)}.")
]
Psf = Annotated[
    Path | None,
    typer.Option(
        "--psf",
        help="Measured PSF (.npz, .npy or a picture) of fixed_measured, or for that of a lens, "
        "coded_aperture or diffuser.",
    ),
]
PsfPitch = Annotated[
    float | None,
    typer.Option("--psf-pitch", help="Side of a cell of an .npy file or a picture, in metres."),
]
PsfDistance = Annotated[
    float | None,
    typer.Option(
        "--psf-distance", help="Its distance to the sensor, in metres; the encoder's by default."
    ),
]
Shape = Annotated[
    str | None,
    typer.Option("--embedding", help="ROWSxCOLUMNS[@FILL]; 24x32 unless told otherwise."),
]
Binning = Annotated[
    str | None,
    typer.Option("--binning", help="area: mean of a pixel; point: its centre (the paper's)."),
]
ChangeName = Annotated[
    str | None, typer.Option("--change", help=f"Of the scene: one of {', '.join(TRANSFORMS)}.")
]
RecipeName = Annotated[str | None, typer.Option("--recipe", help=f"One of {', '.join(RECIPES)}.")]
AllowVisible = Annotated[
    bool,
    typer.Option(
        "--allow-visible",
        help="Let a mask show pictures of the scene, which no daemon takes unless told to.",
    ),
]
EndToEnd = Annotated[
    bool | None,
    typer.Option(
        "--end-to-end", help="Learn mask and Scene classifier together in a second stage."
    ),
]


def given(**options: object) -> dict[str, object]:
    """Those options that were given."""
    return {name: value for name, value in options.items() if value is not None}


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


def opened(
    load: Callable[..., FitSettings], folder: Path, *, skip_damaged: bool
) -> tuple[FitSettings, Source]:
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
