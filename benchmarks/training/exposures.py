"""What several exposures through masks of their own are worth, with as many values in all.

One learned mask is read at so many values; two or four, shown one after the other, share them. A
change of the panel and an exposure each cost the camera time; computing the transfers costs the
fit time. What is finished is kept in ``--work`` and not computed again.

    python -m benchmarks.training.exposures --data data/mnist --work runs/exposures \
        --figures benchmarks/results/data.json --picture docs/images/exposures.png
"""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import torch
import typer
from benchmarks.figures import FiguresOption, record
from rich.console import Console

from veilcam_optics.camera.geometry import Camera
from veilcam_training.config.recipes import Situation, find_recipe
from veilcam_training.config.settings import Settings
from veilcam_training.data import open_source
from veilcam_training.experiments.fit import run_fit
from veilcam_training.experiments.style import panels_of, tidy
from veilcam_training.trainer.callbacks import FitProgress, make_progress

SHAPES = {12: {1: "3x4", 2: "2x3", 4: "1x3"}, 48: {1: "6x8", 2: "4x6", 4: "3x4"}}
"""Embedding of each exposure, by the number of values in all and that of exposures."""
INTERVAL = 4.303 / 3**0.5
"""Half of a 95 % interval of the mean of three, in standard deviations (Student's t, 2 degrees)."""
SEEDS = 3
SETTLE = 0.1
"""What the daemon waits for another mask to be shown, by default [s]."""


@dataclass(frozen=True)
class Cell:
    """So many values, read in so many exposures."""

    values: int
    exposures: int
    classifier: str

    @property
    def name(self) -> str:
        """Of its figures."""
        return f"exposures_{self.classifier}_{self.values}_in_{self.exposures}"

    def settings(self, seed: int, epochs: int | None) -> Settings:
        """Of one fit."""
        shape = SHAPES[self.values][self.exposures]
        situation = Situation(classifier=self.classifier, embedding=shape)
        recipe = find_recipe("default", situation)
        if epochs is not None:
            recipe = recipe.model_copy(update={"epochs": epochs})
        return Settings(
            classifier=self.classifier,
            embedding=shape,
            exposures=self.exposures,
            seed=seed,
            recipe=recipe,
        )


@dataclass(frozen=True)
class Outcome:
    """Of one fit: test accuracy [%], and processor time of an epoch [s]."""

    accuracy: float
    seconds: float


def fitted(cell: Cell, seed: int, data: Path, work: Path, epochs: int | None) -> Outcome:
    """One fit, taken from ``work`` if it was finished there."""
    kept = work / f"{cell.name}_{seed}_{epochs or 'all'}.json"
    if kept.exists():
        return Outcome(**json.loads(kept.read_text()))
    settings = cell.settings(seed, epochs)
    started = time.process_time()
    with make_progress(Console()) as progress:
        bar = FitProgress(progress, f"{cell.name} seed {seed}", settings.recipe.epochs)
        result = run_fit(settings, open_source("mnist", data), Camera(), callbacks=[bar])
    taken = (time.process_time() - started) / settings.recipe.epochs
    outcome = Outcome(100 * result.accuracy.value, taken)
    kept.write_text(json.dumps(asdict(outcome)))
    return outcome


def interval(values: Sequence[float]) -> float:
    """Half of the 95 % interval of the mean of three."""
    return INTERVAL * statistics.stdev(values)


def verdict(single: Sequence[float], several: Sequence[float]) -> str:
    """Of several exposures against one, seed by seed: a win or a loss beyond the interval."""
    gains = [more - one for one, more in zip(single, several, strict=True)]
    gain, half = statistics.mean(gains), interval(gains)
    return f"{gain:+.2f} +- {half:.2f} " + ("tie" if abs(gain) <= half else "beyond it")


def draw(found: Mapping[Cell, Sequence[Outcome]], path: Path) -> None:
    """Accuracy over the time that the camera waits, and over that of an epoch."""
    figure, ((waiting, fitting),) = panels_of(1, 2, (4, 3))
    for colour, values in (("#1f6fb5", 12), ("#d1495b", 48)):
        cells = [cell for cell in found if cell.values == values]
        if not cells:
            continue
        mean = [statistics.mean(each.accuracy for each in found[cell]) for cell in cells]
        half = [interval([each.accuracy for each in found[cell]]) for cell in cells]
        epoch = [statistics.median(each.seconds for each in found[cell]) for cell in cells]
        waited = [1000 * SETTLE * cell.exposures for cell in cells]
        for axes, across in ((waiting, waited), (fitting, epoch)):
            name = f"{values} values"
            axes.errorbar(across, mean, half, label=name, color=colour, marker="o", capsize=3)
            for x, y, cell in zip(across, mean, cells, strict=True):
                axes.annotate(
                    str(cell.exposures), (x, y), (5, -11), textcoords="offset points", color=colour
                )
    waiting.set_xlabel("waiting for the panel [ms]")
    fitting.set_xlabel("processor time of an epoch [s]")
    waiting.set_ylabel("test accuracy [%]")
    waiting.set_title("by the camera's time; beside a point: exposures", fontsize=9)
    fitting.set_title("by the fit's time", fontsize=9)
    waiting.legend(loc="lower left", frameon=False)
    for axes in (waiting, fitting):
        tidy(axes)
    figure.savefig(path, dpi=150)


def main(
    *,
    data: Annotated[Path, typer.Option(help="Folder with MNIST's four idx files.")],
    work: Annotated[Path, typer.Option(help="Folder for what is finished.")],
    values: Annotated[list[int] | None, typer.Option(help="Of SHAPES; all by default.")] = None,
    classifier: Annotated[str, typer.Option(help="As veilcam-train fit takes it.")] = "LR",
    epochs: Annotated[int | None, typer.Option(min=1, help="Of the recipe by default.")] = None,
    figures: FiguresOption = None,
    picture: Annotated[Path | None, typer.Option(help="Picture to write, *.png.")] = None,
) -> None:
    """Fit every cell with three seeds; print, draw and record the means."""
    torch.set_num_threads(1)
    work.mkdir(parents=True, exist_ok=True)
    found: dict[Cell, list[Outcome]] = {}
    for total in values or SHAPES:
        for exposures in SHAPES[total]:
            cell = Cell(total, exposures, classifier)
            found[cell] = [fitted(cell, seed, data, work, epochs) for seed in range(SEEDS)]
            accuracies = [each.accuracy for each in found[cell]]
            single = [each.accuracy for each in found[Cell(total, 1, classifier)]]
            print(
                f"{total} values, {exposures} of {SHAPES[total][exposures]}: "
                f"{statistics.mean(accuracies):.2f} +- {interval(accuracies):.2f} %, "
                f"against one: {verdict(single, accuracies)}"
            )
    recorded: dict[str, float] = {}
    for cell, outcomes in found.items():
        accuracies = [each.accuracy for each in outcomes]
        recorded[cell.name] = round(statistics.mean(accuracies), 2)
        recorded[f"{cell.name}_interval"] = round(interval(accuracies), 2)
        recorded[f"{cell.name}_epoch_s"] = round(
            statistics.median(each.seconds for each in outcomes), 1
        )
    if picture is not None:
        draw(found, picture)
    record(figures, recorded)


if __name__ == "__main__":
    typer.run(main)
