"""Own pictures, from a folder to a served camera: time, labels, and fits that are killed.

    python -m benchmarks.training.own_pictures shapes --figures benchmarks/results/data.json
    python -m benchmarks.training.own_pictures photographs --data data/cifar10
        --figures benchmarks/results/data.json

``shapes`` runs the commands of the tutorial on pictures that ``veilcam-train draw`` draws, and asks
the daemon about every test picture. ``photographs`` writes 5,000 of CIFAR-10 as files, a fifth of
them test pictures, and fits them within a budget of processor time; then it fits them again, kills
that fit with SIGKILL at three moments, and compares the two.
"""

from __future__ import annotations

import csv
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import typer
from benchmarks.figures import FiguresOption, record
from PIL import Image

from veilcam_client import Camera
from veilcam_server.demo.daemon import running
from veilcam_training.bundle import Bundle, read_bundle
from veilcam_training.cli.fit import BUNDLE, parse_budget
from veilcam_training.data import Source, open_source

app = typer.Typer(pretty_exceptions_enable=False)

TRAIN = str(Path(sys.executable).with_name("veilcam-train"))
PHOTOGRAPHS, TESTED, ASKED = 4000, 1000, 200
MOMENTS = (0.0, 0.3, 0.7)
"""Shares of a fit's epochs after which it is killed: the first time while it learns the mask."""
INTO = 3.0
"""Time from such a moment to the kill [s]."""


def run(*arguments: str) -> str:
    """Run ``veilcam-train``, and return its output."""
    command = (TRAIN, *arguments)
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def answers(bundle: Path, pictures: Sequence[Path], folder: Path) -> list[str]:
    """Return the label of each picture, as a client of a simulated camera gets it."""
    with running(bundle, pictures[0], folder, "--scene-api") as url, Camera(url) as camera:
        labels = []
        for path in pictures:
            camera.simulation.hold_scene(path.read_bytes())
            labels.append(camera.classify().label)
    return labels


def agreement(bundle: Path, pictures: Sequence[Path], labels: Sequence[str]) -> float:
    """Return the percent of ``labels`` that ``predict`` gives, too."""
    told = [
        line.split("\t")[1]
        for line in run("predict", str(bundle), *map(str, pictures)).split("\n")
        if line
    ]
    return 100 * float(np.mean([one == other for one, other in zip(told, labels, strict=True)]))


def right(pictures: Sequence[Path], labels: Sequence[str]) -> float:
    """Return the percent of ``labels`` that are the names of the pictures' folders."""
    return 100 * float(
        np.mean([path.parent.name == label for path, label in zip(pictures, labels, strict=True)])
    )


def processor_seconds(fit: Sequence[str]) -> float:
    """Run a fit, and return the processor time that it took [s]."""
    before = os.times()
    run(*fit)
    after = os.times()
    return (after.children_user + after.children_system) - (
        before.children_user + before.children_system
    )


def write_photographs(source: Source, folder: Path) -> None:
    """Write photographs as a folder of pictures with labels."""
    for part, images, count in (
        ("train", source.training(), PHOTOGRAPHS),
        ("test", source.test(), TESTED),
    ):
        for number in range(count):
            place = folder / part / source.labels[int(images.labels[number])]
            place.mkdir(parents=True, exist_ok=True)
            pixels = images.pixels[number].movedim(0, -1).numpy()
            Image.fromarray(pixels).save(place / f"{number:05}.png")


def epochs_done(folder: Path) -> list[dict[str, str]]:
    """Return the epochs of a fit's history so far."""
    path = folder / "history.csv"
    if not path.exists():
        return []
    with path.open() as file:
        return list(csv.DictReader(file))


def killed(fit: Sequence[str], folder: Path, epochs: int) -> int:
    """Run a fit that is killed at each of :data:`MOMENTS`, and resumed.

    Args:
        fit: arguments of the command.
        folder: folder of the fit.
        epochs: epochs that it is expected to have.

    Returns:
        Number of kills.
    """
    kills = 0
    for moment in MOMENTS:
        process = subprocess.Popen([TRAIN, *fit, *(("--resume",) if kills else ())])
        while process.poll() is None:
            if (folder / "work").is_dir() and len(epochs_done(folder)) >= moment * epochs:
                time.sleep(INTO)
                kills += process.poll() is None
                process.kill()
                process.wait()
            time.sleep(0.05)
    run(*fit, "--resume")
    return kills


def same(one: Bundle, other: Bundle) -> bool:
    """Return whether two bundles have the same mask, weights, accuracy and hiding figures."""
    first, second = one.pairs[0], other.pairs[0]
    return (
        np.array_equal(first.levels, second.levels)
        and first.weights.keys() == second.weights.keys()
        and all(np.array_equal(first.weights[name], second.weights[name]) for name in first.weights)
        and one.accuracy == other.accuracy
        and one.hiding == other.hiding
    )


@app.command()
def shapes(
    count: Annotated[int, typer.Option(help="Pictures to draw.")] = 2000,
    seed: Annotated[int, typer.Option(help="Seed of the pictures; the mask's is secret.")] = 1,
    figures: FiguresOption = None,
) -> None:
    """Draw, fit and serve shapes; ask the daemon about every test picture."""
    with TemporaryDirectory() as name:
        folder, out = Path(name, "shapes"), Path(name, "fitted")
        run("draw", str(folder), "--count", str(count), "--seed", str(seed))
        run("fit", "--data", str(folder), "--out", str(out))
        shown = sorted((folder / "test").rglob("*.png"))
        labels = answers(out / BUNDLE, shown, Path(name))
        values = {
            "folder_accuracy": right(shown, labels),
            "folder_commands": 3,
            "predict_agreement": agreement(out / BUNDLE, shown, labels),
        }
    print(values)
    record(figures, values)


@app.command()
def photographs(
    data: Annotated[Path, typer.Option(help="Folder of CIFAR-10's files.")],
    budget: Annotated[str, typer.Option(help="Budget of the fit.")] = "3m",
    work: Annotated[
        Path | None, typer.Option(help="Empty folder to keep photographs and fits in.")
    ] = None,
    figures: FiguresOption = None,
) -> None:
    """Fit 5,000 photographs within a budget; kill, resume and compare; ask the daemon."""
    with TemporaryDirectory() as name:
        place = Path(name) if work is None else work
        folder, whole, broken = place / "photographs", place / "whole", place / "broken"
        write_photographs(open_source("cifar10", data), folder)
        shape = ("--data", str(folder), "--embedding", "27x36", "--seed", "1")
        seconds = processor_seconds(["fit", *shape, "--budget", budget, "--out", str(whole)])
        epochs = len(epochs_done(whole))
        # The budget's choice depends on the machine's speed of the moment: both have the same.
        again = ("fit", *shape, "--epochs", str(epochs), "--out", str(broken))
        kills = killed(again, broken, epochs)
        one, other = (read_bundle(each / BUNDLE) for each in (whole, broken))
        shown = sorted((folder / "test").rglob("*.png"))[:: TESTED // ASKED]
        labels = answers(whole / BUNDLE, shown, place)
        values = {
            "budget_kept_ratio": seconds / parse_budget(budget),
            "photographs_accuracy": right(shown, labels),
            "resume_identical": float(kills == len(MOMENTS) and same(one, other)),
            "photographs_agreement": agreement(whole / BUNDLE, shown, labels),
        }
    print(f"{epochs} epochs in {seconds:.0f} s, {kills} kills; {values}")
    record(figures, values)


if __name__ == "__main__":
    app()
