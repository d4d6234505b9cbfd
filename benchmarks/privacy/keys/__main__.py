"""What answers and memory tell whoever has no key. One command a proof.

``python -m benchmarks.privacy.keys answers runs/rest --figures benchmarks/results/keys.json``
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.privacy.keys import served
from benchmarks.privacy.keys.costs import preparation_times, read_sealed, sealing_times
from benchmarks.privacy.keys.options import BundleOption, SeedOption, fresh_bundle, shown_progress
from benchmarks.rig import work_folder

from veilcam_server.demo_data import FRESH
from veilcam_training.data import open_source

app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False)
app.command("answers")(served.answers)
app.command("past")(served.past)


@app.command()
def times(
    *,
    rounds: Annotated[int, typer.Option(min=1)] = 100,
    bundle: BundleOption = FRESH,
    figures: FiguresOption = None,
) -> None:
    """Time sealing, opening and the preparation of epochs, on one core."""
    contents = fresh_bundle(bundle)
    measurement = np.full(contents.embedding.shape, 0.5, np.float32)
    sealing = sealing_times(contents, measurement, rounds)
    with work_folder() as folder:
        preparing = preparation_times(contents, folder, rounds)
    for name, took in {**sealing, **{f"prepare {k}": v for k, v in preparing.items()}}.items():
        print(f"{name:16}{took:9.3f} ms")
    record(
        figures,
        {
            "seal_open_ms": round(sealing["seal"] + sealing["open"], 3),
            "seal_open_first_ms": round(sealing["seal"] + sealing["open_first"], 3),
            "envelope_ms": round(sealing["envelope"], 3),
            "prepare_sealed_ms": round(preparing["sealed"], 2),
            "prepare_sealed_ratio": round(preparing["sealed"] / preparing["mask"], 3),
        },
    )


@app.command()
def accuracy(
    *,
    data: Annotated[Path, typer.Option(help="Folder of MNIST's files.")],
    images: Annotated[int, typer.Option(min=1, help="Of the test set, a mask each.")] = 10_000,
    bundle: BundleOption = FRESH,
    seed: SeedOption = 1,
    figures: FiguresOption = None,
) -> None:
    """Read sealed digits with a receiver's key, and compare with the daemon's own labels."""
    contents = fresh_bundle(bundle)
    shown = open_source("mnist", data).test()
    shown = shown.take(torch.arange(min(images, len(shown))))
    right = alike = 0
    with shown_progress() as progress:
        for read in progress.track(read_sealed(contents, shown, seed), total=len(shown)):
            right += read.holder == read.truth
            alike += read.holder == read.daemon
    print(f"{100 * right / len(shown):.2f} % right, {alike} of {len(shown)} as the daemon says")
    record(
        figures,
        {
            "fresh_accuracy_sealed": round(100 * right / len(shown), 2),
            "fresh_sealed_as_daemon": round(alike / len(shown), 6),
        },
    )


if __name__ == "__main__":
    torch.set_num_threads(1)
    app()
