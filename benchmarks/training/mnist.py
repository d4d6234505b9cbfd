"""Test accuracy of a learned mask with logistic regression at 24 x 32 on the whole of MNIST.

54,000 training images, 6,000 to select the epoch, one look at the 10,000 test images.

    python -m benchmarks.training.mnist --data data/mnist --figures benchmarks/results/main-job.json
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import torch
import typer
from benchmarks.figures import FiguresOption, record
from rich.console import Console

from veilcam_optics.camera.geometry import Camera
from veilcam_training.config.recipes import find_recipe
from veilcam_training.config.settings import FitSettings
from veilcam_training.data import open_source
from veilcam_training.experiments.fit import run_fit
from veilcam_training.trainer.callbacks import FitProgress, make_progress


def main(
    *,
    data: Annotated[Path, typer.Option(help="Folder with MNIST's four idx files.")],
    seed: int = 0,
    threads: Annotated[int, typer.Option(min=1)] = 1,
    figures: FiguresOption = None,
) -> None:
    """Fit, print the accuracy and record it in percent."""
    torch.set_num_threads(threads)
    settings = find_recipe("default", FitSettings(classifier="LR", seed=seed))
    with make_progress(Console()) as progress:
        bar = FitProgress(progress, "LR learned 24x32")
        outcome = run_fit(settings, open_source("mnist", data), Camera(), callbacks=[bar])
    seconds = sum(epoch.seconds for epoch in outcome.fit.history)
    percent = 100 * outcome.accuracy.value
    print(
        f"validation {100 * outcome.fit.best.validation_accuracy:.2f} %  test {percent:.2f} %  "
        f"{seconds:.0f} s"
    )
    record(figures, {"mnist_lr_learned_24x32": round(percent, 2)})


if __name__ == "__main__":
    typer.run(main)
