"""What heads read behind a learned mask: the best one, also of the picture itself, and LR.

    python -m benchmarks.training.heads faces_glasses_best_24x32 --data data/faces
        --work runs/heads --figures benchmarks/results/data.json

Each cell is fitted to the training part, its epoch chosen on the validation part, and the test set
is looked at once, after that. A cell that was broken off is taken up from its last epoch in
``--work``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist
from typing import Annotated

import torch
import typer
from benchmarks.figures import FiguresOption, record

from veilcam_optics.camera.geometry import Camera, Embedding
from veilcam_training.bundle import write_bundle
from veilcam_training.config.recipes import BEST_LINEAR, SCENES, Recipe
from veilcam_training.config.settings import Settings
from veilcam_training.data import Images, Source, open_source, split
from veilcam_training.encoders import FixedEncoder, Setup
from veilcam_training.experiments.fit import run_fit
from veilcam_training.experiments.keyring import as_bundle
from veilcam_training.experiments.model import make_model
from veilcam_training.models.classifiers import SceneTask, make_layers
from veilcam_training.models.lensless import LenslessClassifier
from veilcam_training.seeding import seeded
from veilcam_training.trainer.callbacks import Epoch
from veilcam_training.trainer.evaluation import evaluate
from veilcam_training.trainer.loop import fit
from veilcam_training.transforms.augmentation import Augmentation

LEVEL = 0.95
"""Of the interval that test images of this number leave, were they drawn from many such."""
HELD = SCENES.model_copy(
    update={
        "mask_start": "sharp",
        "mask_rate": 0.0,
        "pooling": 2,
        "rank": 512,
        "jitter": Augmentation(mirror=True),
    }
)
"""A mask that was learned from the training scenes, without labels, and stays."""


@dataclass(frozen=True)
class Cell:
    """One fit: of a data set, by a recipe, behind a camera or of the picture itself."""

    data: str
    epochs: int
    recipe: Recipe = HELD
    classifier: str = "ResNet16"
    pixels: bool = False
    embedding: str = "24x32"
    starts: int = 1
    """Masks that are begun with; the one that validates best goes on to the test."""

    @property
    def settings(self) -> Settings:
        """Of the first fit."""
        recipe = self.recipe.model_copy(update={"epochs": self.epochs})
        return Settings(
            data=self.data,
            embedding=self.embedding,
            classifier=self.classifier,
            recipe=recipe,
            seed=1,
        )


PLAIN = HELD.model_copy(update={"mask_start": "random", "snr_db": None})
CELLS: Mapping[str, Cell] = {
    "faces_glasses_best_24x32": Cell("faces-glasses", epochs=5),
    "faces_gender_best_24x32": Cell("faces-gender", epochs=7),
    "faces_smiling_best_24x32": Cell("faces-smiling", epochs=14),
    "faces_smiling_pixels": Cell("faces-smiling", 6, PLAIN, "ResNet8", pixels=True),
    "mnist_LR_3x4": Cell(
        "mnist", 100, BEST_LINEAR["3x4"], classifier="LR", embedding="3x4", starts=4
    ),
}
"""By the names of their figures."""


class Log:
    """Prints every epoch, for runs whose output goes to a file."""

    def step(self, epoch: int, done: int, steps: int) -> None:
        """Say nothing."""

    def epoch(self, epoch: Epoch) -> None:
        """One line."""
        print(
            f"epoch {epoch.number + 1}  loss {epoch.loss:.4f}  "
            f"training {100 * epoch.training_accuracy:.2f} %  "
            f"validation {100 * epoch.validation_accuracy:.2f} %  {epoch.seconds:.0f} s",
            flush=True,
        )


def interval(share: float, count: int) -> tuple[float, float]:
    """Ends of Wilson's interval of a share of ``count`` (Wilson 1927)."""
    z = NormalDist().inv_cdf((1 + LEVEL) / 2)
    middle = (share + z**2 / (2 * count)) / (1 + z**2 / count)
    half = math.sqrt(share * (1 - share) / count + z**2 / (4 * count**2)) * z / (1 + z**2 / count)
    return middle - half, middle + half


def chance(training: Images, test: Images) -> float:
    """Share of test images that have the commonest label of the training images."""
    commonest = training.labels.bincount().argmax()
    return float((test.labels == commonest).float().mean())


def read_camera(settings: Settings, source: Source, work: Path) -> float:
    """Test accuracy behind the camera; the bundle is left in ``work``."""
    camera = Camera()
    result = run_fit(
        settings, source, camera, checkpoint=work / "fit.checkpoint", callbacks=[Log()]
    )
    write_bundle(work / "pair.veilcam", as_bundle([result], source, camera))
    return result.accuracy.value


def read_started(settings: Settings, starts: int, source: Source, work: Path) -> float:
    """Test accuracy of that of several fits which validates best; the others are never tested."""
    parts, fits = split(source.training()), []
    for seed in range(settings.seed, settings.seed + starts):
        chosen = settings.model_copy(update={"seed": seed})
        fitted = fit(
            make_model(chosen, source, Camera()),
            parts,
            chosen.recipe,
            seed,
            checkpoint=work / f"start-{seed}.checkpoint",
            fingerprint=chosen.fingerprint(source),
        )
        print(f"start {seed}: validation {100 * fitted.best.validation_accuracy:.2f} %", flush=True)
        fits.append((fitted.best.validation_accuracy, -seed, fitted.model))
    _, seed, model = max(fits, key=lambda each: each[:2])
    return evaluate(model, source.test(), -seed, "test").accuracy


def read_pixels(settings: Settings, source: Source, work: Path) -> float:
    """Test accuracy of the same network on the picture itself, without camera or noise."""
    scene, recipe = source.scene, settings.recipe
    setup = Setup(Camera(), scene, Embedding(scene.rows, scene.columns))
    layers = make_layers(
        settings.classifier,
        SceneTask(1, scene.rows, scene.columns, len(source.labels), centred=True),
        dropout=recipe.dropout,
    )
    identity = FixedEncoder(setup, [torch.eye(scene.rows * scene.columns)])
    with seeded(settings.seed, "classifier"):
        model = LenslessClassifier(identity, layers, recipe.snr_db)
    model.classifier.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    fitted = fit(
        model,
        split(source.training()),
        recipe,
        settings.seed,
        checkpoint=work / "fit.checkpoint",
        fingerprint=settings.fingerprint(source) + " pixels",
        callbacks=[Log()],
    )
    return evaluate(fitted.model, source.test(), settings.seed, "test").accuracy


def main(
    name: Annotated[str, typer.Argument(help=f"One of {', '.join(CELLS)}.")],
    *,
    data: Annotated[Path, typer.Option(help="Folder that holds the data set's files.")],
    work: Annotated[Path, typer.Option(help="Folder for checkpoints: resumes what is in it.")],
    figures: FiguresOption = None,
) -> None:
    """Fit one cell; print and record its accuracy, interval and chance in percent."""
    torch.set_num_threads(1)
    cell, place = CELLS[name], work / name
    place.mkdir(parents=True, exist_ok=True)
    source, settings = open_source(cell.data, data), cell.settings
    if cell.starts > 1:
        share = read_started(settings, cell.starts, source, place)
    else:
        share = (read_pixels if cell.pixels else read_camera)(settings, source, place)
    test = source.test()
    low, high = interval(share, len(test))
    values = {
        name: share,
        f"{name}_low": low,
        f"{name}_high": high,
        f"{cell.data.replace('-', '_')}_chance": chance(source.training(), test),
    }
    percent = {key: round(100 * value, 2) for key, value in values.items()}
    print(percent)
    record(figures, percent)


if __name__ == "__main__":
    typer.run(main)
