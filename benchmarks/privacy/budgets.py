"""Budgets of embeddings behind one mask, from what the worst attacker reads by how many it knows.

``python -m benchmarks.privacy.budgets --data data/mnist --work runs/budgets
--figures benchmarks/results/privacy.json --picture docs/images/budgets.png``

Digits behind fresh masks of the bundle that comes along, in two forms and three sizes. Of a mask,
``n`` captures are known with what they show, and others are to be read. The attackers: a network
fitted to captures behind other keys, which needs none of them; kernels, neighbours and a network
on the ``n``; angles to them, as learned behind masks of the attacker's own. Which of them, and with
which settings, is chosen behind masks that were set apart, and judged behind others.

The budget of a form is the least ``n`` at which it is shown that more than a point above chance is
read, at any size: 0: nothing may leave; 1: one alone
tells nothing, a second beside it does.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.privacy.keys.options import shown_progress
from matplotlib.figure import Figure
from torch import Tensor

from veilcam_optics.camera.geometry import Embedding
from veilcam_optics.decoding import SceneDecoding
from veilcam_optics.files import write_whole
from veilcam_optics.transfer.operator import Reach, TransferOperator
from veilcam_server.demo_data import FRESH
from veilcam_training.attacks.known_pairs import Mask, Reader, by_anchors, hits, readers, tuned
from veilcam_training.attacks.linkage import by_products, link_area
from veilcam_training.attacks.networks import (
    TRIALS,
    Build,
    Seen,
    best_of,
    by_network,
    convolutions,
    perceptron,
)
from veilcam_training.attacks.victim import FORMS, FreshMasks, Victim, VictimMask
from veilcam_training.bundle import Bundle, read_bundle
from veilcam_training.data import Images, open_source
from veilcam_training.experiments.style import GRID
from veilcam_training.seeding import derive, stream

Form = Literal["white", "raw"]
FORM_NAMES: tuple[Form, ...] = ("white", "raw")
EMBEDDINGS = (Embedding(3, 4), Embedding(12, 16), Embedding(24, 32))
CLASSES = 10
ALPHA = 0.01
BAR = 1.0
"""Points above chance that count as nothing."""
EPOCHS = 6
RIDGES = (0.1, float("inf"))


@dataclass(frozen=True)
class Plan:
    """How much is tried.

    Attributes:
        counts: of captures that are known, in rising order; the first is 0.
        own: masks of the attacker's own to learn angles behind.
        check: masks to choose settings by.
        test: masks to be judged behind.
        asked: captures of each to be read.
        wide: masks of the attacker's own to learn from without any that is known, and captures of
            each.
    """

    counts: tuple[int, ...] = (0, 1, 3, 10, 30, 100, 300)
    own: int = 30
    check: int = 6
    test: int = 20
    asked: int = 300
    wide: tuple[int, int] = (250, 30)


class Digits:
    """Scenes of which every class comes equally often."""

    def __init__(self, images: Images) -> None:
        self._images = images
        self._places = [(images.labels == label).nonzero().flatten() for label in range(CLASSES)]

    def draw(self, count: int, random: torch.Generator) -> tuple[Tensor, Tensor]:
        """Scenes (count, rows, columns) and their classes."""
        labels = torch.randint(CLASSES, (count,), generator=random)
        chosen = [
            int(self._places[label][torch.randint(len(self._places[label]), (), generator=random)])
            for label in labels.tolist()
        ]
        return self._images.scenes(torch.tensor(chosen)), labels


class Study:
    """One form at one size: masks, and what is known of them.

    Args:
        bundle: of mode fresh.
        cell: the form in which captures leave, and how large they are.
        data: to learn from, and to be judged by.
        plan: how much is tried.
        seed: of all that is drawn.
    """

    def __init__(
        self,
        bundle: Bundle,
        cell: tuple[Form, Embedding],
        data: tuple[Digits, Digits],
        plan: Plan,
        seed: int,
    ) -> None:
        if bundle.fresh is None:
            raise typer.BadParameter("use a bundle of mode fresh")
        (form, embedding), self._plan = cell, plan
        light = TransferOperator(bundle.camera, bundle.scene, embedding, reach=Reach(6, 1))
        assumed = TransferOperator(bundle.camera, bundle.scene, embedding)
        decoding = SceneDecoding(assumed, bundle.fresh.statistics, bundle.fresh.noise)
        self._shape, self._seed = embedding.shape, seed
        self._random = stream(seed, "scenes", form, embedding.size)
        self._victim = Victim(
            light,
            FreshMasks(bundle.camera, bundle.fresh.distribution),
            FORMS[form],
            # What leaves raw needs no whitening.
            decoding=decoding if form == "white" else None,
            generator=stream(seed, "masks", form, embedding.size),
        )
        training, test = data
        self._known = training.draw(plan.counts[-1], self._random)
        self._own = self._masks(training, plan.own)
        self._check = self._masks(training, plan.check)
        self._test = self._masks(test, plan.test)
        self._training = training

    def _masks(self, digits: Digits, count: int) -> list[Mask]:
        found = []
        for _ in range(count):
            mask = self._victim.mask()
            asked = digits.draw(self._plan.asked, self._random)
            found.append(Mask(self._seen(mask, *self._known), self._seen(mask, *asked)))
        return found

    def _seen(self, mask: VictimMask, scenes: Tensor, labels: Tensor) -> Seen:
        return Seen(self._victim.capture(mask, scenes), labels)

    def keyless(self) -> Reader:
        """A network fitted to captures behind other keys; it needs none that is known."""
        masks, captures = self._plan.wide
        parts = []
        for _ in range(masks):
            drawn = self._training.draw(captures, self._random)
            parts.append(self._seen(self._victim.mask(), *drawn))
        learned = Seen(
            _scaled(torch.cat([each.vectors for each in parts])),
            torch.cat([each.labels for each in parts]),
        )
        check = Seen(
            _scaled(torch.cat([mask.asked.vectors for mask in self._check])),
            torch.cat([mask.asked.labels for mask in self._check]),
        )
        builds: list[Build] = [partial(convolutions, self._shape, width=32), perceptron]
        tried = [
            partial(by_network, build=build, trial=TRIALS[0], epochs=EPOCHS) for build in builds
        ]
        scores = best_of(tried)(learned, check, CLASSES)

        def read(known: Seen, vectors: Tensor, classes: int) -> Tensor:
            del known, classes
            with torch.no_grad():
                return scores(_scaled(vectors)).double()

        return read

    def attack(self, keyless: Reader, count: int) -> Point:
        """The worst attacker that knows ``count`` captures."""
        own, check, test = (
            [mask.of_first(count) for mask in masks]
            for masks in (self._own, self._check, self._test)
        )
        tried: dict[str, Reader] = {"network behind other keys": keyless}
        if count > 0:
            tried |= readers()
            for ridge in RIDGES:
                name = f"angles, ridge {ridge:g}"
                tried[name] = by_anchors(own, check, CLASSES, ridge=ridge, epochs=EPOCHS)
        name, best = tuned(tried, check, CLASSES)
        shares = 100 * hits(best, test, CLASSES).double().mean(1)
        return Point(name, shares.tolist())

    def same_scene(self, scenes: int = 20) -> float:
        """Area under the curve of "two captures of one mask show the same scene"."""
        pairs = []
        for _ in range(self._plan.test):
            mask = self._victim.mask()
            shown, _ = self._training.draw(scenes, self._random)
            pairs.append([self._victim.capture(mask, shown) for _ in range(2)])
        first, second = (torch.stack([pair[side] for pair in pairs]) for side in range(2))
        return link_area(by_products, first, second)


def _scaled(vectors: Tensor) -> Tensor:
    """Less their own mean and of variance 1: brightness apart, which differs from mask to mask."""
    apart = vectors - vectors.mean(1, keepdim=True)
    return apart / apart.std(1, keepdim=True).clamp_min(torch.finfo(vectors.dtype).tiny)


def interval(shares: list[float], seed: int) -> tuple[float, float]:
    """Ends of the two one-sided 99 % intervals of the mean over masks, by bootstrap over masks."""
    random = np.random.default_rng(derive(seed, "bootstrap"))
    drawn = random.choice(np.array(shares), (10_000, len(shares))).mean(axis=1)
    low, high = np.quantile(drawn, (ALPHA, 1 - ALPHA))
    return float(low), float(high)


@dataclass(frozen=True)
class Point:
    """The worst attacker at one count: its name, and what it read of each mask [%]."""

    attacker: str
    shares: list[float]

    @property
    def mean(self) -> float:
        """Over masks [%]."""
        return float(np.mean(self.shares))


Curves = dict[tuple[Form, Embedding], dict[int, Point]]


def budget(curves: Curves, form: Form, seed: int) -> int:
    """The least count at which more than :data:`BAR` points above chance are shown to be read.

    Where none is, the largest that was tried.
    """
    of_form = [points for (each, _), points in curves.items() if each == form]
    counts = sorted(of_form[0])
    for count in counts:
        lows = [interval(points[count].shares, seed)[0] for points in of_form]
        if max(lows) > 100 / CLASSES + BAR:
            return count
    return counts[-1]


def size(embedding: Embedding) -> str:
    """As in ``24x32``."""
    return f"{embedding.rows}x{embedding.columns}"


def measured(
    bundle: Bundle, data: tuple[Digits, Digits], work: Path, plan: Plan, seed: int
) -> tuple[Curves, dict[str, float]]:
    """All curves, and the areas of "the same scene"; each cell is kept in ``work``."""
    curves: Curves = {}
    areas: dict[str, float] = {}
    cells: list[tuple[Form, Embedding]] = [(f, e) for f in FORM_NAMES for e in EMBEDDINGS]
    with shown_progress() as progress:
        task = progress.add_task("forms and sizes", total=len(cells) * len(plan.counts))
        for form, embedding in cells:
            path = work / f"{form}-{size(embedding)}-{seed}.json"
            if not path.exists():
                study = Study(bundle, (form, embedding), data, plan, seed)
                keyless, points = study.keyless(), {}
                for count in plan.counts:
                    points[count] = asdict(study.attack(keyless, count))
                    progress.advance(task)
                said = {"plan": asdict(plan), "points": points, "same": study.same_scene()}
                write_whole(path, json.dumps(said).encode())
            said = json.loads(path.read_text())
            if said["plan"] != json.loads(json.dumps(asdict(plan))):
                raise typer.BadParameter(f"{path} is of another plan: use an empty --work")
            curves[form, embedding] = {int(n): Point(**p) for n, p in said["points"].items()}
            areas[f"{form}_{size(embedding)}"] = said["same"]
            progress.update(task, completed=len(curves) * len(plan.counts))
    return curves, areas


def draw(curves: Curves, path: Path, seed: int) -> None:
    """Chart what the worst attacker reads against what is known, form beside form."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for panel, form in zip(panels, FORM_NAMES, strict=True):
        for (each, embedding), points in curves.items():
            if each != form:
                continue
            counts = sorted(points)
            ends = np.array([interval(points[n].shares, seed) for n in counts])
            means = [points[n].mean for n in counts]
            panel.plot(counts, means, marker="o", markersize=4, label=size(embedding))
            panel.fill_between(counts, ends[:, 0], ends[:, 1], alpha=0.2)
        panel.axhline(100 / CLASSES, color="#777777", linestyle=":", label="chance")
        panel.set_xscale("symlog", linthresh=1)
        panel.set_xticks(sorted(points), [str(n) for n in sorted(points)])
        panel.set_xlabel("captures of the mask that are known")
        panel.set_title(f"{form}: {budget(curves, form, seed)} may leave")
        panel.grid(color=GRID)
        panel.minorticks_off()
    panels[0].set_ylabel("other digits behind it read [%]")
    panels[0].set_ylim(0, 100)
    panels[0].legend(title="embedding", loc="upper left")
    figure.savefig(path, dpi=120)


app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def measure(
    *,
    data: Annotated[Path, typer.Option(help="Folder of MNIST's files.")],
    work: Annotated[Path, typer.Option(help="Folder of what was measured: resumes it.")],
    picture: Annotated[Path | None, typer.Option(help="Chart to write, .png or .svg.")] = None,
    seed: Annotated[int, typer.Option(help="Of masks, scenes and noise.")] = 1,
    figures: FiguresOption = None,
) -> None:
    """Measure the curves, say the budgets by them, and chart both."""
    source = open_source("mnist", data)
    digits = Digits(source.training()), Digits(source.test())
    work.mkdir(parents=True, exist_ok=True)
    curves, areas = measured(read_bundle(FRESH), digits, work, Plan(), seed)
    values: dict[str, float] = {}
    for (form, embedding), points in curves.items():
        for count, point in points.items():
            low, high = interval(point.shares, seed)
            print(
                f"{form:6}{size(embedding):7}{count:5} known: {point.mean:5.1f} % "
                f"[{low:.1f}, {high:.1f}] by {point.attacker}"
            )
            values[f"budget_{form}_{size(embedding)}_{count}_known"] = round(point.mean, 2)
    for name, found in areas.items():
        print(f"{name}: the same scene behind one mask: AUC {found:.4f}")
        values[f"budget_{name}_same_scene_auc"] = round(found, 4)
    for form in FORM_NAMES:
        values[f"budget_{form}"] = budget(curves, form, seed)
        print(f"{form}: {values[f'budget_{form}']:.0f} may leave behind a mask")
    if picture is not None:
        draw(curves, picture, seed)
    record(figures, values)


if __name__ == "__main__":
    torch.set_num_threads(1)
    app()
