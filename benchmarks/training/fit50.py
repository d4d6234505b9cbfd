"""How long 50 epochs of FC-800 behind a learned mask take at 24 x 32, on the whole of MNIST.

54,000 training images, 6,000 to validate after every epoch; the paper's job, for which it took 280
minutes on two A5000 GPUs. The time is that of the epochs, validation included. The load average is
printed beside it, because whatever else the machine does takes its share.

    python -m benchmarks.training.fit50 --data data/mnist --figures benchmarks/results/training.json
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import torch
import typer
from benchmarks.figures import FiguresOption, record
from rich.console import Console

from veilcam_optics.camera.geometry import Camera
from veilcam_training.config.recipes import find_recipe
from veilcam_training.config.settings import FitSettings
from veilcam_training.data import open_source, split
from veilcam_training.experiments.model import make_model
from veilcam_training.trainer.callbacks import FitProgress, make_progress
from veilcam_training.trainer.loop import fit

EPOCHS = 50


def main(
    *,
    data: Annotated[Path, typer.Option(help="Folder with MNIST's four idx files.")],
    recipe: Annotated[str, typer.Option(help="By name; its number of epochs does not count.")] = (
        "best"
    ),
    seed: int = 0,
    threads: Annotated[int, typer.Option(min=1)] = 2,
    figures: FiguresOption = None,
) -> None:
    """Fit, print minutes and validation accuracy, and record them."""
    torch.set_num_threads(threads)
    settings = find_recipe(recipe, FitSettings(classifier="FC800", seed=seed)).model_copy(
        update={"epochs": EPOCHS, "patience": None}
    )
    source = open_source(settings.data, data)
    before = os.getloadavg()[0]
    with make_progress(Console()) as progress:
        bar = FitProgress(progress, "FC800 learned 24x32")
        result = fit(
            make_model(settings, source, Camera()),
            split(source.training()),
            settings,
            callbacks=[bar],
        )
    minutes = sum(epoch.seconds for epoch in result.history) / 60
    percent = 100 * result.best.validation_accuracy
    print(
        f"{EPOCHS} epochs in {minutes:.1f} minutes on {threads} threads  "
        f"validation {percent:.2f} %  load average {before:.1f} before, {os.getloadavg()[0]:.1f} "
        "after (1 minute)"
    )
    record(
        figures,
        {"fit50_minutes": round(minutes, 2), "fit50_validation_percent": round(percent, 2)},
    )


if __name__ == "__main__":
    typer.run(main)
