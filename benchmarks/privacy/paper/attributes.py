"""Attributes read from embeddings by classifiers that were fitted to plaintext pairs, 24 x 32."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.privacy.keys.options import shown_progress
from benchmarks.privacy.paper.cells import (
    Cells,
    DataOption,
    Mean,
    Values,
    WorkOption,
    gray,
    one_of_each,
    row,
)
from benchmarks.privacy.paper.generator import Attacked, masks_folder
from benchmarks.privacy.paper.masks import KINDS, Kind, embedded
from scipy.stats import norm

from veilcam_training.attacks.intervals import area
from veilcam_training.attacks.networks import (
    TRIALS,
    Attacker,
    Seen,
    best_of,
    by_network,
    convolutions,
    judged,
    linear,
    perceptron,
)
from veilcam_training.data import Source, open_source
from veilcam_training.seeding import stream

SOURCES = ("faces-gender", "faces-smiling")
PAIRS = (1000, 10_000)
EPOCHS = 6


def attackers(shape: tuple[int, int]) -> list[Attacker]:
    """Three networks; the one that does best on pairs set apart counts."""
    builds = (linear, perceptron, partial(convolutions, shape))
    return [partial(by_network, build=build, trial=TRIALS[0], epochs=EPOCHS) for build in builds]


def command(
    *,
    data: DataOption,
    source: Annotated[
        list[str] | None, typer.Option(help=f"Data set; {', '.join(SOURCES)} by default.")
    ] = None,
    work: WorkOption = Path("runs/paper-attributes"),
    count: Annotated[int, typer.Option(min=50, help="Pictures that are attacked.")] = 2000,
    pairs: Annotated[
        list[int] | None, typer.Option(min=20, help="That the attacker holds; all by default.")
    ] = None,
    kind: Annotated[
        list[str] | None, typer.Option(help="Masks: 1, 10, 100 or 10random; all by default.")
    ] = None,
    figures: FiguresOption = None,
) -> None:
    """Read a yes or no from embeddings behind few or many masks."""
    names, numbers = source or list(SOURCES), pairs or list(PAIRS)
    kinds = [each for each in KINDS if not kind or each.name in kind]
    cells = Cells(work, {"count": count, "epochs": EPOCHS})
    values: dict[str, float] = {}
    with shown_progress() as progress:
        task = progress.add_task("cells", total=len(names) * len(kinds) * len(numbers))
        for name in names:
            opened = open_source(name, data)
            if len(opened.labels) != 2:
                raise typer.BadParameter(f"{name} has {len(opened.labels)} classes: use one of two")
            # All tasks share the masks of the first, as one camera does.
            attacked = Attacked(opened, masks_folder(work, names[0]))
            for each in kinds:
                for number in numbers:
                    cell = f"{name.removeprefix('faces-')}_{each.name}_{number}"
                    progress.update(task, description=cell)
                    made = partial(attack, attacked, opened, each, number, count)
                    found = cells.get(cell, made)
                    half = float(norm.isf(0.005)) * found["error"]
                    row(f"attribute_auc_{cell}", Mean(found["auc"], half), None, "chance 0.5")
                    values[f"attribute_auc_{cell}"] = round(found["auc"], 3)
                    progress.advance(task)
    record(figures, values)


def attack(attacked: Attacked, source: Source, kind: Kind, number: int, count: int) -> Values:
    """One cell."""
    embeddings, images, _ = attacked.pairs(kind, number)
    learned = Seen(embeddings[:number], images.labels[:number])
    check = Seen(embeddings[number:], images.labels[number:])
    scores = best_of(attackers(attacked.operator.embedding.shape))(learned, check, 2)
    images = source.test()
    places = one_of_each(images, min(count, len(images)), "attributes", "test")
    noise = stream(1, "pairs", "attributes", kind.name)
    seen = embedded(attacked.operator, attacked.masks(kind), gray(images, places), noise)
    logits = judged(scores, seen)
    positive = torch.eq(images.labels[places], 1).numpy()
    auc, error = area((logits[:, 1] - logits[:, 0]).double().numpy(), positive)
    return {"auc": auc, "error": error}
