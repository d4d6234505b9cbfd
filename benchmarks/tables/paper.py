"""The paper's tables 1 to 4 beside ours, from the records of figures.

``python -m benchmarks.tables.paper benchmarks/results/data.json`` writes how many cells are filled,
and draws the chart of all of them.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from itertools import product
from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.figures import record_figures
from benchmarks.paper.grid import CAMERAS, PAPER_HEADS, TABLES, Column, Place, Row, load_paper
from benchmarks.paper.results import HIDING, Verdict, verdict_of
from benchmarks.paper.style import COLOURS, MARKERS, NAMES, encoder_title, tidy
from benchmarks.tables.table import ROOT
from veilcam_training.models.classifiers import reads_scenes

CHART = ROOT / "docs" / "images" / "tables.png"
RECORDS = ("fresh-masks", "training", "data")
"""Records of cells; of two with one figure the later holds."""
SCENE = "Scene32"
"""Any scene classifier: figures do not tell them apart."""
HEADS: Mapping[str, tuple[str, ...]] = {
    "mnist": ("LR", "FC800", SCENE),
    "fashion": ("FC800", SCENE),
    "robust": ("FC800", "CNN16", SCENE),
    "faces": ("FC800", SCENE),
    "cifar10": ("VGG11", SCENE),
}
FILLS: Mapping[str, tuple[str, ...]] = {"faces": ("24x32@0.1",)}
SCORED = ("mnist", "robust", "cifar10")
"""Tables 1, 2 and 4 of the paper; the data set of table 3 cannot be had."""
SIGNS: Mapping[Verdict | None, str] = {"win": " ▲", "loss": " ▼", "tie": " =", None: ""}


class Measured(NamedTuple):
    """Accuracy of a place [percent]."""

    value: float
    interval: float | None
    """Half of the 95 % interval of the mean over seeds; None of one seed."""
    seeds: int
    hiding: tuple[float, ...]
    """Shares that attackers without the key get right [percent], in the order of ``HIDING``."""


class Score(NamedTuple):
    """Cells of the paper's tables 1, 2 and 4."""

    missing: tuple[str, ...]
    verdicts: Counter[Verdict | None]
    """Of the cells that are filled; None: fewer than three seeds."""


@cache
def repository_figures() -> Mapping[str, float]:
    """Return the figures of the repository's records."""
    found: dict[str, float] = {}
    for name in RECORDS:
        record = json.loads((ROOT / "benchmarks" / "results" / f"{name}.json").read_text())
        found |= {key: entry["value"] for key, entry in record.items()}
    return found


def measured(place: Place, figures: Mapping[str, float]) -> Measured | None:
    """Return what was measured at a place, or None."""
    name = place.figure
    if name not in figures:
        return None
    hiding = tuple(figures[f"{name}_{each}"] for each in HIDING if f"{name}_{each}" in figures)
    seeds = int(figures.get(f"{name}_seeds", 1))
    return Measured(figures[name], figures.get(f"{name}_interval"), seeds, hiding)


def paper_table(name: str) -> str:
    """Return a table of the paper beside ours, in Markdown."""
    columns, figures = _columns(name), repository_figures()
    titles = [TABLES[name].column_title(column) for column in columns]
    lines = [f"| classifier | camera | {' | '.join(titles)} |", f"|---|---|{'---:|' * len(titles)}"]
    for row in _rows(name):
        cells = [(place, measured(place, figures)) for place in _places(row, columns)]
        papers = any(load_paper().accuracy.get(place.name) for place, _ in cells)
        if any(found for _, found in cells) or papers:
            head = "scene" if reads_scenes(row.classifier) else row.classifier
            texts = " | ".join(_cell(place, found) for place, found in cells)
            lines.append(f"| {head} | {encoder_title(row)} | {texts} |")
    return "\n".join(lines) + "\n"


def score(figures: Mapping[str, float]) -> Score:
    """Return which of the paper's cells are filled, and how they end.

    A cell is compared by the paper's classifier, averaged pixels before sampled ones. A scene
    classifier stands in for the paper's best one, behind the same mask before one with a bound.
    """
    verdicts, missing = Counter[Verdict | None](), []
    for name in SCORED:
        for place in (each for row in _rows(name) for each in _places(row, _columns(name))):
            row, paper = place.row, load_paper().accuracy.get(place.title)
            # The robust table's first column is a cell of the first table.
            if paper is None or row.binning == "point" or place.column in _seen(name):
                continue
            alike = [row, row._replace(binning="point")]
            if row.classifier in PAPER_HEADS.values():
                masks = (row.encoder, "hidden") if row.encoder == "learned" else (row.encoder,)
                alike += [Row(SCENE, mask, "area") for mask in masks]
            tried = (measured(Place(each, place.column), figures) for each in alike)
            found = next((each for each in tried if each is not None), None)
            if found is None:
                missing.append(place.title)
            else:
                verdicts[verdict_of(*found[:3], paper)] += 1
    return Score(tuple(missing), verdicts)


def scores() -> str:
    """Return the score in a sentence."""
    missing, verdicts = score(repository_figures())
    filled = verdicts.total()
    return (
        f"Of the paper's {filled + len(missing)} cells in tables 1, 2 and 4, {filled} are filled: "
        f"{verdicts['win']} wins, {verdicts['tie']} ties, {verdicts['loss']} losses, and "
        f"{verdicts[None]} with fewer than three seeds, which decide nothing.\n"
    )


def draw(path: Path, figures: Mapping[str, float]) -> None:
    """Draw accuracy against the size of an embedding, and against what is read without the key."""
    figure = Figure(figsize=(11, 7.5), layout="constrained")
    panels = figure.subplots(2, 2)
    for axes, name in zip(panels[0], ("mnist", "cifar10"), strict=True):
        _draw_sizes(axes, name, figures)
    for axes, name in zip(panels[1], ("mnist", "cifar10"), strict=True):
        _draw_hiding(axes, name, figures)
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    figure.savefig(path, dpi=110)


def _draw_sizes(axes: Axes, name: str, figures: Mapping[str, float]) -> None:
    """Draw the best classifier of each camera, over the sizes."""
    columns = _columns(name)
    for camera in CAMERAS:
        points = []
        for column in columns:
            rows = [row for row in _rows(name) if row.encoder == camera and row.binning == "area"]
            found = [measured(place, figures) for row in rows for place in _places(row, [column])]
            values = [each.value for each in found if each is not None]
            height, width = map(int, column.embedding.split("x"))
            points += [(height * width, max(values))] if values else []
        axes.plot(
            *zip(*points, strict=True) if points else ([], []),
            color=COLOURS[camera],
            marker=MARKERS[camera],
            label=NAMES[camera],
        )
    axes.set(
        xscale="log",
        xlabel="numbers in a gray embedding",
        ylabel="read right [%]",
        title=f"{TABLES[name].title}: best classifier",
    )
    tidy(axes)


def _draw_hiding(axes: Axes, name: str, figures: Mapping[str, float]) -> None:
    for row, column in product(_rows(name), _columns(name)):
        found = measured(Place(row, column), figures)
        if found is not None and len(found.hiding) == len(HIDING):
            axes.plot(
                found.hiding[-1],
                found.value,
                color=COLOURS[row.encoder],
                marker=MARKERS[row.encoder],
            )
            axes.annotate(
                column.embedding,
                (found.hiding[-1], found.value),
                fontsize=8,
                xytext=(5, -3),
                textcoords="offset points",
            )
    axes.set(
        xlabel="read right without the key [%]",
        ylabel="read right with it [%]",
        xlim=(0, 100),
        ylim=(0, 102),
        title="With the key and without",
    )
    tidy(axes)


def _rows(name: str) -> Iterator[Row]:
    for row in (Row(*each) for each in product(HEADS[name], CAMERAS, ("area", "point"))):
        if row.binning == "area" or not reads_scenes(row.classifier):
            yield row


def _columns(name: str) -> Sequence[Column]:
    table = TABLES[name]
    sizes = (*table.embeddings, *FILLS.get(name, ()))
    return tuple(Column(*each) for each in product(table.datasets, table.changes, sizes))


def _seen(name: str) -> Sequence[Column]:
    return _columns("mnist") if name == "robust" else ()


def _places(row: Row, columns: Sequence[Column]) -> Iterator[Place]:
    return (Place(row, column) for column in columns)


def _cell(place: Place, found: Measured | None) -> str:
    paper = place.paper
    if found is None:
        return "–" if paper is None or place.row.binning == "point" else f"– ({paper:.1f})"
    text = f"{found.value:.2f}"
    if found.interval is not None:
        text += f" ± {found.interval:.2f}"
    if paper is not None:
        text += f" ({paper:.1f}{SIGNS[verdict_of(*found[:3], paper)]})"
    if found.hiding:
        text += f"<br>*{' / '.join(f'{each:.0f}' for each in found.hiding)}*"
    return text


def command(
    record: Annotated[Path, typer.Argument(help="Record to write the figures into.")],
) -> None:
    """Write how many of the paper's cells are filled, and draw the chart."""
    figures = repository_figures()
    missing, verdicts = score(figures)
    filled = verdicts.total()
    counts = {"wins": verdicts["win"], "ties": verdicts["tie"], "losses": verdicts["loss"]}
    fraction = {"cells_filled_fraction": round(filled / (filled + len(missing)), 3)}
    record_figures(record, fraction | counts)
    draw(CHART, figures)
    print(f"{fraction | counts}; missing: {', '.join(missing) or 'none'}")


if __name__ == "__main__":
    typer.run(command)
