"""Budgets of embeddings behind one mask, from what the worst attacker reads by how many it knows.

``python -m benchmarks.privacy.budgets --data data/mnist --work runs/budgets
--figures benchmarks/results/privacy.json --picture docs/images/budgets.png``

Digits behind fresh masks of the bundle that comes along, in two forms and three sizes. Of a mask,
``n`` captures are known with what they show, and others are to be read. The attackers: a network
fitted to captures behind other keys, which needs none of them; kernels, neighbours and a network
on the ``n``; angles to them, as learned behind masks of the attacker's own. Or of those others
nothing is known: networks on sets of captures, in several views. Which attacker it is, and with
which settings, is chosen behind masks that were set apart, and judged behind others.

The budget of a form is the least ``n``, of captures known or not, at which it is shown that more
than a point above chance is read, at any size: 0: nothing may leave; 1: one alone
tells nothing, a second beside it does.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.privacy.budgets.curves import budget, draw, interval, measured, size
from benchmarks.privacy.budgets.study import FORM_NAMES, Digits, Plan

from veilcam_server.demo_data import FRESH
from veilcam_training.bundle import read_bundle
from veilcam_training.data import open_source

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
    cells = measured(read_bundle(FRESH), digits, work, Plan(), seed)
    values: dict[str, float] = {}
    for (form, embedding), cell in cells.items():
        name = f"{form}_{size(embedding)}"
        for kind, points in (("known", cell.known), ("unknown", cell.crowd)):
            for count, point in points.items():
                low, high = interval(point.shares, seed)
                print(
                    f"{form:6}{size(embedding):7}{count:5} {kind:8} {point.mean:5.1f} % "
                    f"[{low:.1f}, {high:.1f}] by {point.attacker}"
                )
                values[f"budget_{name}_{count}_{kind}"] = round(point.mean, 2)
        if form == "white":  # inner products of raw captures are those of their mean
            print(f"{form:6}{size(embedding):7} the same scene: AUC {cell.same_scene:.4f}")
            values[f"budget_{name}_same_scene_auc"] = round(cell.same_scene, 4)
    for form in FORM_NAMES:
        values[f"budget_{form}"] = budget(cells, form, seed)
        print(f"{form}: {values[f'budget_{form}']:.0f} may leave behind a mask")
    if picture is not None:
        draw(cells, picture, seed)
    record(figures, values)


if __name__ == "__main__":
    torch.set_num_threads(1)
    app()
