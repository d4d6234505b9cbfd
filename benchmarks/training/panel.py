"""Does training under a panel's errors make a mask that a real panel can show?

Two fits with one seed: one expects an ideal panel, the other one that is displaced, of the wrong
gamma and never quite dark (`panel_errors`). Both are then shown by the same panels, each wrong in
its own way, none of which was drawn in training. Validation images, noise included.

    python -m benchmarks.training.panel --data data/mnist --figures benchmarks/results/training.json
"""

from __future__ import annotations

from pathlib import Path
from statistics import mean
from typing import Annotated

import torch
import typer
from benchmarks.figures import FiguresOption, record
from rich.console import Console
from rich.table import Table

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.camera.masks import to_weights
from veilcam_training.config.recipes import find_recipe
from veilcam_training.config.settings import FitSettings
from veilcam_training.data import Images, Split, open_source, split
from veilcam_training.encoders import FixedEncoder, Mask, PanelErrors
from veilcam_training.encoders.imperfections import make_operators
from veilcam_training.experiments.model import make_model
from veilcam_training.models.lensless import LenslessClassifier
from veilcam_training.models.whitening import plain
from veilcam_training.seeding import stream
from veilcam_training.trainer.callbacks import FitProgress, make_progress
from veilcam_training.trainer.loop import fit
from veilcam_training.trainer.step import evaluate

ERRORS = PanelErrors(gamma=0.1, floor=0.05, shift=5e-5, distance=5e-5)
PANELS = 20


def accuracy(model: LenslessClassifier, built: Imperfections, images: Images, seed: int) -> float:
    """Accuracy [percent] of ``model`` behind the panel of a camera as it was built."""
    encoder = model.encoder
    assert isinstance(encoder, Mask)
    weights = built.shown(
        torch.from_numpy(to_weights(encoder.levels(), encoder.setup.camera.panel))
    )
    operators = make_operators(encoder.setup, built)
    shown = LenslessClassifier(
        FixedEncoder(encoder.setup, [operator(weights) for operator in operators]),
        model.layers,
        model.snr_db,
    )
    shown.classifier.load_state_dict(plain(model.classifier).state_dict())
    return 100 * evaluate(shown, images, seed, "panel").accuracy


def draw_panels(count: int, seed: int) -> list[Imperfections]:
    """Panels with errors up to :data:`ERRORS`."""
    draws = torch.rand(count, 5, generator=stream(seed, "panels"), dtype=torch.float64)
    return [
        Imperfections(
            gamma=1 + ERRORS.gamma * (2 * gamma - 1),
            contrast_floor=ERRORS.floor * floor,
            shift_y=ERRORS.shift * (2 * y - 1),
            shift_x=ERRORS.shift * (2 * x - 1),
            distance_error=ERRORS.distance * (2 * along - 1),
        )
        for gamma, floor, y, x, along in draws.tolist()
    ]


def fitted(parts: Split, settings: FitSettings, data: Path, name: str) -> LenslessClassifier:
    """The model of ``settings``, fitted."""
    with make_progress(Console()) as progress:
        bar = FitProgress(progress, name)
        model = make_model(settings, open_source(settings.data, data), Camera())
        return fit(model, parts, settings, callbacks=[bar]).model


def main(
    *,
    data: Annotated[Path, typer.Option(help="Folder with MNIST's four idx files.")],
    embedding: str = "12x16",
    epochs: Annotated[int, typer.Option(min=1)] = 15,
    seed: int = 0,
    figures: FiguresOption = None,
) -> None:
    """Print accuracies and record them."""
    torch.set_num_threads(1)
    chosen = FitSettings(embedding=embedding, classifier="FC800", seed=seed)
    chosen = find_recipe("default", chosen).model_copy(update={"epochs": epochs})
    parts = split(open_source("mnist", data).training())
    panels = draw_panels(PANELS, seed)
    table = Table("trained for", "ideal panel", f"{PANELS} panels that err, mean", "worst of them")
    values: dict[str, float] = {}
    for name, errors in (("ideal", PanelErrors()), ("erring", ERRORS)):
        settings = chosen.model_copy(update={"panel_errors": errors})
        model = fitted(parts, settings, data, f"{name} panel")
        ideal = accuracy(model, NOMINAL, parts.validation, seed)
        wrong = [accuracy(model, panel, parts.validation, seed) for panel in panels]
        table.add_row(f"an {name} panel", *(f"{v:.2f} %" for v in (ideal, mean(wrong), min(wrong))))
        values |= {
            f"panel_trained_{name}_shown_ideal": round(ideal, 2),
            f"panel_trained_{name}_shown_erring": round(mean(wrong), 2),
        }
    Console().print(table)
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
