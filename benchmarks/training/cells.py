"""Accuracy of scene classifiers behind hidden and fresh masks, and what reading costs.

    python -m benchmarks.training.cells cifar10_hidden_27x36 --data data/cifar10
        --work runs/cells --seeds 5 --figures benchmarks/results/data.json
    python -m benchmarks.training.cells times --figures benchmarks/results/data.json

Each seed is fitted to the training part, its epoch chosen on the validation part, and the test set
is looked at once, after that. What is done stands in ``--work``, a file for each seed, and is not
done again.
"""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import torch
import typer
from benchmarks.figures import FiguresOption, record

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.decoding import MeasurementNoise, Precision, SceneFrame, SceneStatistics
from veilcam_optics.keys.masks import draw_levels
from veilcam_training.bundle import Network
from veilcam_training.bundle.layers import Linear
from veilcam_training.config.files import load_settings
from veilcam_training.data import Images, Source, open_source
from veilcam_training.errors import require
from veilcam_training.experiments.fit import run_fit, run_fresh
from veilcam_training.models.classifiers import SceneTask, Task, make_layers
from veilcam_training.models.network import build_untrained, weights_of
from veilcam_training.trainer.callbacks import Callback, Epoch

STUDENT = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262)
"""Quantiles 0.975 of Student's t, of 1 to 9 degrees of freedom."""
TIMES = "times"
MASKS = 5
"""Unseen masks that the test set is spread over."""


@dataclass(frozen=True)
class Cell:
    """Fit of one data set at one size."""

    data: str
    embedding: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    """Of the settings of a fit."""
    classifier: str = "Scene32"

    def accuracy(self, source: Source, seed: int) -> float:
        """Test accuracy of a fit, in [0, 1]."""
        chosen = {
            "data": self.data,
            "embedding": self.embedding,
            "classifier": self.classifier,
            "seed": seed,
            **self.changes,
        }
        settings = load_settings(None, chosen, colour=source.colour)
        if settings.fresh is not None:
            found = run_fresh(settings, source, Camera(), masks=MASKS, callbacks=[Log()])
            return found.accuracy.value
        return run_fit(settings, source, Camera(), callbacks=[Log()]).accuracy.value


CELLS: Mapping[str, Cell] = {
    "cifar10_hidden_27x36": Cell("cifar10", "27x36"),
    "cifar10_hidden_6x8": Cell("cifar10", "6x8"),
    "cifar10_fresh_27x36": Cell("cifar10", "27x36", {"fresh": {}}),
    "mnist_hidden_24x32": Cell("mnist", "24x32", classifier="Scene16"),
    # Of twelve numbers no eye sees anything: there is no bound.
    "mnist_hidden_3x4": Cell("mnist", "3x4", {"hidden": False, "end_to_end": True}, "Scene16"),
}
"""By the names of their figures."""


class Log(Callback):
    """Prints every epoch, for runs whose output goes to a file."""

    def epoch(self, epoch: Epoch) -> None:
        """One line."""
        print(
            f"epoch {epoch.number + 1}  loss {epoch.loss:.4f}  "
            f"validation {100 * epoch.validation_accuracy:.2f} %  {epoch.seconds:.0f} s",
            flush=True,
        )


@dataclass(frozen=True)
class Fewer:
    """First images of a data set, for a try."""

    source: Source
    count: int

    def __getattr__(self, name: str) -> Any:
        """All else is as it is."""
        return getattr(self.source, name)

    def training(self) -> Images:
        """First training images."""
        return self._first(self.source.training())

    def test(self) -> Images:
        """First test images."""
        return self._first(self.source.test())

    def _first(self, images: Images) -> Images:
        return images.take(torch.arange(min(self.count, len(images))))


def interval(values: Sequence[float]) -> float:
    """Half of a 95 % interval of the mean of 2 to 10 values."""
    half: float = STUDENT[len(values) - 2] * statistics.stdev(values) / len(values) ** 0.5
    return half


def fitted(cell: Cell, source: Source, seed: int, done: Path) -> dict[str, float]:
    """Accuracy [percent] and core minutes of one seed, from ``done`` where it was done."""
    if done.exists():
        return dict(json.loads(done.read_text()))
    started = time.process_time()
    percent = 100 * cell.accuracy(source, seed)
    found = {"accuracy": percent, "minutes": (time.process_time() - started) / 60}
    done.write_text(json.dumps(found))
    return found


def milliseconds(run: Callable[[], object], times: int) -> float:
    """Median time of the processor of a call; the first one warms up."""
    run()
    seconds = []
    for _ in range(times):
        started = time.process_time()
        run()
        seconds.append(time.process_time() - started)
    return 1e3 * statistics.median(seconds)


def times_of_reading(scene: Scene, embedding: Embedding, rank: int) -> dict[str, float]:
    """Time to read one picture in colour, and to prepare a fresh mask, as the daemon does both."""
    values, inputs = 3 * scene.rows * scene.columns, 3 * embedding.size
    first = Linear(inputs=inputs, outputs=rank)
    task = Task(
        *(3, embedding.rows, embedding.columns, 10),
        rectified=True,
        normalisation="per_pixel",
        estimate=(
            SceneTask(3, scene.rows, scene.columns, 10),
            (first, Linear(inputs=rank, outputs=values)),
        ),
    )
    layers = make_layers("Scene32", task)
    network = Network.load(layers, weights_of(build_untrained(layers)))
    random = np.random.default_rng(0)
    seen = random.random((1, inputs), np.float32)
    # The time does not depend on what is known of scenes.
    known: SceneStatistics[npt.NDArray[Any]] = SceneStatistics(
        random.random(values, np.float32),
        random.standard_normal((values, rank), np.float32) / rank,
        random.random(values, np.float32) / 100,
    )
    frame = SceneFrame(Camera(), scene, embedding, known, MeasurementNoise(40.0))
    decoding = frame.decoding(precision=Precision.DOUBLE)
    levels = draw_levels(bytes(32), camera=frame.camera)
    prepared = milliseconds(lambda: decoding.prepare(frame.shown(levels)), 5)
    return {
        "head_numpy_ms": round(milliseconds(lambda: network(seen), 30), 2),
        "fresh_colour_prepare_s": round(prepared / 1e3, 3),
    }


def main(
    name: Annotated[
        str, typer.Argument(metavar="CELL", help=f"One of {', '.join(CELLS)}, or {TIMES}.")
    ],
    *,
    data: Annotated[Path, typer.Option(help="Folder that holds the data set's files.")] = Path(),
    work: Annotated[Path, typer.Option(help="Folder for a file of each seed.")] = Path("runs"),
    seeds: Annotated[int, typer.Option(min=1, max=10, help="Fits, of seeds from 1 on.")] = 5,
    images: Annotated[
        int | None, typer.Option(min=100, help="Of each part, for a try; all by default.")
    ] = None,
    figures: FiguresOption = None,
) -> None:
    """Fit one cell; print and record its mean accuracy in percent, and its core minutes."""
    torch.set_num_threads(1)
    if name == TIMES:
        values = times_of_reading(Scene(rows=32, columns=32), Embedding(27, 36), 512)
    else:
        require(name in CELLS, f"cell {name!r} is unknown: use one of {', '.join(CELLS)}")
        cell, place = CELLS[name], work / name
        place.mkdir(parents=True, exist_ok=True)
        source = open_source(cell.data, data)
        if images is not None:
            source = Fewer(source, images)
        found = []
        for seed in range(1, seeds + 1):
            found.append(fitted(cell, source, seed, place / f"{seed}.json"))
            print(f"seed {seed}: {found[-1]}", flush=True)
        accuracies = [each["accuracy"] for each in found]
        minutes = statistics.mean(each["minutes"] for each in found)
        values = {name: round(statistics.mean(accuracies), 2)}
        if seeds > 1:
            values[f"{name}_interval"] = round(interval(accuracies), 2)
        values[f"{name}_core_minutes"] = round(minutes, 2)
    print(values)
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
