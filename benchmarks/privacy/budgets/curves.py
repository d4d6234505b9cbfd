"""Curves of the worst attacker over what it holds of a mask, and the budgets that follow."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import typer
from benchmarks.paper.style import GRID
from benchmarks.privacy.budgets.study import (
    BAR,
    CLASSES,
    EMBEDDINGS,
    FORM_NAMES,
    Digits,
    Form,
    Plan,
    Point,
    Study,
    crowd,
)
from benchmarks.privacy.keys.options import shown_progress
from matplotlib.figure import Figure

from veilcam_optics.camera.geometry import Embedding
from veilcam_optics.files import write_whole
from veilcam_training.bundle import Bundle
from veilcam_training.seeding import derive

ALPHA = 0.01


def interval(shares: list[float], seed: int) -> tuple[float, float]:
    """Ends of the two one-sided 99 % intervals of the mean over masks, by bootstrap over masks."""
    random = np.random.default_rng(derive(seed, "bootstrap"))
    drawn = random.choice(np.array(shares), (10_000, len(shares))).mean(axis=1)
    low, high = np.quantile(drawn, (ALPHA, 1 - ALPHA))
    return float(low), float(high)


Curves = dict[tuple[Form, Embedding], dict[int, Point]]


@dataclass(frozen=True)
class Cell:
    """What was measured of one form at one size.

    Attributes:
        known: the worst attacker by how many captures it knows.
        crowd: the worst attacker by how many others there are of which nothing is known.
        same_scene: area under the curve of "two captures of one mask show the same scene".
    """

    known: dict[int, Point]
    crowd: dict[int, Point]
    same_scene: float


Cells = dict[tuple[Form, Embedding], Cell]


def budget(cells: Cells, form: Form, seed: int) -> int:
    """The least count of other captures, known or not, with which more than a bar is shown read.

    The bar is :data:`BAR` points above chance. Where nothing is read, the largest that was tried.
    """
    found, tried = [], []
    for (each, _), cell in cells.items():
        if each == form:
            for count, point in (*cell.known.items(), *cell.crowd.items()):
                tried.append(count)
                if interval(point.shares, seed)[0] > 100 / CLASSES + BAR:
                    found.append(count)
    return min(found, default=max(tried))


def size(embedding: Embedding) -> str:
    """As in ``24x32``."""
    return f"{embedding.rows}x{embedding.columns}"


def measured(
    bundle: Bundle, data: tuple[Digits, Digits], work: Path, plan: Plan, seed: int
) -> Cells:
    """All cells; each is kept in ``work``, and not measured twice."""
    cells: Cells = {}
    asked: list[tuple[Form, Embedding]] = [(f, e) for f in FORM_NAMES for e in EMBEDDINGS]
    with shown_progress() as progress:
        task = progress.add_task("forms and sizes", total=len(asked) * (len(plan.counts) + 1))
        for form, embedding in asked:
            path = work / f"{form}-{size(embedding)}-{seed}.json"
            said: dict[str, Any] = {"plan": asdict(plan)}
            if not path.exists():
                study, known = Study(bundle, (form, embedding), data, plan, seed), {}
                keyless = study.keyless()
                for count in plan.counts:
                    known[count] = study.attack(keyless, count)
                    progress.advance(task)
                crowded = crowd(bundle, (form, embedding), data, plan, seed)
                said["cell"] = asdict(Cell(known, crowded, study.same_scene()))
                write_whole(path, json.dumps(said).encode())
            kept = json.loads(path.read_text())
            if kept["plan"] != json.loads(json.dumps(said["plan"])):
                raise typer.BadParameter(f"{path} is of another plan: use an empty --work")
            known, crowded = (
                {int(n): Point(**point) for n, point in kept["cell"][name].items()}
                for name in ("known", "crowd")
            )
            cells[form, embedding] = Cell(known, crowded, kept["cell"]["same_scene"])
            progress.update(task, completed=len(cells) * (len(plan.counts) + 1))
    return cells


def draw(cells: Cells, path: Path, seed: int) -> None:
    """Chart what the worst attacker reads against what it has, form beside form."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for panel, form in zip(panels, FORM_NAMES, strict=True):
        for (each, embedding), cell in cells.items():
            if each != form:
                continue
            counts = sorted(cell.known)
            ends = np.array([interval(cell.known[n].shares, seed) for n in counts])
            means = [cell.known[n].mean for n in counts]
            (line,) = panel.plot(counts, means, marker="o", markersize=4, label=size(embedding))
            panel.fill_between(counts, ends[:, 0], ends[:, 1], alpha=0.2)
            others = sorted(cell.crowd)
            unknown = [cell.crowd[n].mean for n in others]
            panel.plot(others, unknown, "--", marker="x", markersize=4, color=line.get_color())
        panel.plot([], [], "--x", color="#777777", markersize=4, label="nothing known of them")
        panel.axhline(100 / CLASSES, color="#777777", linestyle=":", label="chance")
        panel.set_xscale("symlog", linthresh=1)
        panel.set_xlim(-0.2, 1.3 * counts[-1])
        panel.set_xticks(counts, [str(n) for n in counts])
        panel.set_xlabel("other captures of the mask that an attacker has")
        panel.set_title(f"{form}: {budget(cells, form, seed)} may leave behind a mask")
        panel.grid(color=GRID)
        panel.minorticks_off()
    panels[0].set_ylabel("digits behind it that are read [%]")
    panels[0].set_ylim(0, 100)
    panels[0].legend(title="embedding", loc="upper left")
    figure.savefig(path, dpi=120)
