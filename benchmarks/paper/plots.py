"""Pictures of a report: cost, curves, PSFs, embeddings, confusion matrices."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import (
    FixedLocator,
    FuncFormatter,
    LogLocator,
    MaxNLocator,
    NullFormatter,
    NullLocator,
)

from benchmarks.paper.grid import Column
from benchmarks.paper.pictures import Pixels, load_pictures
from benchmarks.paper.results import PICTURES, Entry, Summary, cell_folder
from benchmarks.paper.style import (
    COLOURS,
    MARKERS,
    NAMES,
    encoder_title,
    tidy,
)
from veilcam_optics.camera.geometry import Embedding
from veilcam_training.experiments.card_page import bare, panels_of

POINT_EDGE, EDGE = "#d1495b", "#333333"
LEAST_ERROR = 0.05
"""Percent: less has no place on a logarithmic axis."""
ACCURACIES = (10, 30, 50, 60, 70, 80, 90, 95, 98, 99, 99.5, 99.8)


def draw_charts(folder: Path, summary: Summary, work: Path) -> list[tuple[str, str]]:
    """Draw all that there is something for.

    Args:
        folder: of the pictures.
        summary: of a table with at least one finished cell.
        work: folder of the cells.

    Returns:
        File name and caption of each picture, in the order of the report.
    """
    charts: list[tuple[str, str, Figure | None]] = [
        (
            "cost.png",
            "Accuracy against cost, best in the upper left corner. Training is in seconds of one "
            "core (or GPU). Markers grow with the embedding; their colour is the time "
            "from a measurement to a label (one thread, one measurement at a time, median).",
            draw_cost(summary),
        ),
        (
            "curves.png",
            "Validation accuracy after each epoch; the ring marks the epoch that was kept, the "
            "dashed lines are the paper's sampling.",
            draw_curves(summary),
        ),
        (
            "psfs.png",
            "What a point on the axis becomes on the whole sensor; each picture is scaled to its "
            "own brightest place.",
            draw_psfs(summary, work),
        ),
        (
            "embeddings.png",
            "One validation image as each camera reads it, noise included; each picture is scaled "
            "to its own brightest value.",
            draw_embeddings(summary, work),
        ),
    ]
    charts.extend(
        (
            f"confusion_{classifier}.png",
            f"Confusion matrices of {classifier} on the test set: a row for each true class, a "
            "column for each predicted one, the darker the more often; what was right is left out. "
            "Below each: test accuracy.",
            draw_confusion(summary, classifier),
        )
        for classifier in dict.fromkeys(e.place.row.classifier for e in summary.finished())
    )
    drawn = []
    for name, caption, figure in charts:
        if figure is not None:
            figure.savefig(folder / name, dpi=110, facecolor="white")
            drawn.append((name, caption))
    return drawn


def draw_cost(summary: Summary) -> Figure:
    """Test accuracy against the time of training, one marker for each finished place.

    A marker's shape is its encoder, its area its embedding, its colour its time of inference.
    """
    figure = Figure(figsize=(9, 6), layout="constrained")
    axes = figure.add_subplot()
    entries = summary.finished()
    times = [1e6 * entry.results[0].inference_seconds for entry in entries]
    norm = LogNorm(0.99 * min(times), 1.01 * max(times))
    for entry, micros in zip(entries, times, strict=True):
        row = entry.place.row
        points = axes.scatter(
            entry.results[0].seconds,
            _error(entry),
            s=_area(entry.place.column.embedding),
            c=[micros],
            cmap="viridis_r",
            norm=norm,
            marker=MARKERS[row.encoder],
            edgecolors=POINT_EDGE if row.binning == "point" else EDGE,
            linewidths=1.5 if row.binning == "point" else 0.6,
            zorder=3,
        )
    axes.set(xscale="log", xlabel="training, all epochs [s]")
    _number(axes.xaxis)
    # What is left to gain is the error: on its logarithm 98 and 99 % are as far apart as 80 and 90.
    axes.set(yscale="log", ylabel="test accuracy [%]")
    axes.invert_yaxis()
    axes.yaxis.set_major_locator(FixedLocator([100 - accuracy for accuracy in ACCURACIES]))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 - value:g}"))
    axes.yaxis.set_minor_locator(NullLocator())
    tidy(axes)
    bar = figure.colorbar(points, ax=axes, label="measurement to label [µs]", pad=0.02)
    _number(bar.ax.yaxis)
    figure.legend(
        handles=_legend(entries),
        loc="outside lower center",
        ncols=5,
        frameon=False,
        fontsize=8.5,
    )
    return figure


def _error(entry: Entry) -> float:
    """Test error [percent]."""
    return max(100 - (entry.test or 0), LEAST_ERROR)


def _area(embedding: str) -> float:
    """Area of a marker [square points]: it grows with the side of the embedding."""
    return 18 + 9 * math.sqrt(_pixels(embedding))


def _pixels(embedding: str) -> int:
    return Embedding.parse(embedding).size


def _legend(entries: list[Entry]) -> list[Line2D]:
    encoders = dict.fromkeys(entry.place.row.encoder for entry in entries)
    handles = [_handle(NAMES[name], MARKERS[name], "#777777", 7) for name in encoders]
    if any(entry.place.row.binning == "point" for entry in entries):
        handles.append(_handle("red edge: point binning", "o", "white", 7, edge=POINT_EDGE))
    sizes = sorted({entry.place.column.embedding for entry in entries}, key=_pixels, reverse=True)
    handles += [_handle(size, "o", "#bbbbbb", math.sqrt(_area(size))) for size in sizes]
    return handles


def _handle(
    label: str, marker: str, colour: str, size: float, *, edge: str | None = None
) -> Line2D:
    return Line2D(
        [],
        [],
        linestyle="",
        marker=marker,
        markersize=size,
        markerfacecolor=colour,
        markeredgecolor=edge or colour,
        label=label,
    )


def draw_curves(summary: Summary) -> Figure:
    """A panel for each classifier and column, a line for each encoder."""
    entries = summary.finished()
    classifiers = list(dict.fromkeys(entry.place.row.classifier for entry in entries))
    columns = summary.finished_columns(entries)
    figure, panels = panels_of(len(classifiers), len(columns), (3.3, 2.7))
    for axes_row, classifier in zip(panels, classifiers, strict=True):
        for axes, column in zip(axes_row, columns, strict=True):
            some = [
                entry
                for entry in entries
                if entry.place.column == column and entry.place.row.classifier == classifier
            ]
            for entry in some:
                _curve(axes, entry)
            axes.set_title(f"{classifier}, {summary.table.column_title(column)}", fontsize=9.5)
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
            if not some:
                axes.set_axis_off()
            tidy(axes)
        axes_row[0].set_ylabel("validation accuracy [%]")
    for axes in panels[-1]:
        axes.set_xlabel("epoch")
    shown = dict.fromkeys(entry.place.row.encoder for entry in entries)
    handles = [Line2D([], [], color=COLOURS[name], label=NAMES[name]) for name in shown]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return figure


def _curve(axes: Axes, entry: Entry) -> None:
    result, row = entry.results[0], entry.place.row
    values = [100 * epoch.validation_accuracy for epoch in result.epochs]
    style = {"color": COLOURS[row.encoder], "linewidth": 1.5}
    axes.plot(
        range(1, len(values) + 1),
        values,
        linestyle="--" if row.binning == "point" else "-",
        **style,  # type: ignore[arg-type]
    )
    axes.plot(
        result.best_epoch + 1,
        values[result.best_epoch],
        "o",
        markerfacecolor="white",
        markeredgecolor=COLOURS[row.encoder],
        markersize=5,
    )


def draw_psfs(summary: Summary, work: Path) -> Figure | None:
    """A picture for each camera; a learned mask has one for each embedding and classifier."""
    pictures: dict[str, Pixels] = {}
    for entry in summary.finished():
        row, column = entry.place.row, entry.place.column
        if row.encoder in ("digital", "fresh") or (
            row.encoder != "learned" and row.binning == "point"
        ):
            continue
        title = encoder_title(row)
        if row.encoder in ("learned", "hidden"):
            title += f"\n{row.classifier}, {summary.table.column_title(column)}"
        if title not in pictures:
            psf = load_pictures(_pictures(entry, work)).psf
            if psf is not None:
                pictures[title] = psf
    if not pictures:
        return None
    return _gallery(list(pictures.items()), across=4)


def draw_embeddings(summary: Summary, work: Path) -> Figure | None:
    """A row for each encoder: the scene, and what is read of it at each size."""
    entries = summary.finished()
    columns = summary.finished_columns(entries)
    classifier = entries[0].place.row.classifier
    same = [
        entry
        for entry in entries
        if entry.place.row.classifier == classifier and entry.place.row.encoder != "fresh"
    ]
    if not same:
        return None
    figure, panels = _matrix(summary, same, columns, (1.7, 1.5), lead=("scene",))
    for entry, axes, first in panels:
        pictures = load_pictures(_pictures(entry, work))
        axes.imshow(pictures.embeddings[0], cmap="magma", vmin=0, vmax=1)
        if not first.images:
            first.imshow(pictures.scenes[0], cmap="gray", vmin=0, vmax=1)
    return figure


def draw_confusion(summary: Summary, classifier: str) -> Figure:
    """A matrix for each encoder and column."""
    entries = [e for e in summary.finished() if e.place.row.classifier == classifier]
    figure, panels = _matrix(summary, entries, summary.finished_columns(entries), (1.8, 1.8))
    for entry, axes, _ in panels:
        matrix = np.array(entry.results[0].confusion, dtype=float)
        matrix /= np.maximum(matrix.sum(1, keepdims=True), 1)
        np.fill_diagonal(matrix, 0)
        axes.imshow(np.sqrt(matrix), cmap="Purples", vmin=0, vmax=0.7)
        axes.set_xlabel(f"{entry.test:.1f} %", fontsize=8.5, labelpad=2)
    return figure


def _matrix(
    summary: Summary,
    entries: Sequence[Entry],
    columns: Sequence[Column],
    size: tuple[float, float],
    lead: tuple[str, ...] = (),
) -> tuple[Figure, list[tuple[Entry, Axes, Axes]]]:
    """Panels under the titles ``lead`` and those of ``columns``, a row for each of ``entries``.

    Returns:
        The figure; and each entry with its panel and the first panel of its row.
    """
    rows = [row for row in summary.rows if any(entry.place.row == row for entry in entries)]
    figure, panels = panels_of(len(rows), len(lead) + len(columns), size)
    for axes, title in zip(
        panels[0], (*lead, *map(summary.table.column_title, columns)), strict=True
    ):
        axes.set_title(title, fontsize=9.5)
    found = []
    for (first, *others), row in zip(panels, rows, strict=True):
        for axes in (first, *others):
            bare(axes)
        for axes, column in zip((first, *others)[len(lead) :], columns, strict=True):
            entry = summary.find(row, column)
            if entry is None:
                axes.set_axis_off()
            else:
                found.append((entry, axes, first))
        label = encoder_title(row).replace(", ", "\n")
        first.set_ylabel(label, rotation=0, ha="right", va="center", fontsize=9)
        first.set_axis_on()
    return figure, found


def _pictures(entry: Entry, work: Path) -> Path:
    return cell_folder(work, entry.results[0].cell) / PICTURES


def _gallery(pictures: Sequence[tuple[str, Pixels]], *, across: int) -> Figure:
    down = math.ceil(len(pictures) / across)
    figure, panels = panels_of(down, min(across, len(pictures)), (2.5, 2.25))
    flat = [axes for row in panels for axes in row]
    for axes in flat[len(pictures) :]:
        axes.set_axis_off()
    for axes, (title, picture) in zip(flat, pictures, strict=False):
        bare(axes)
        axes.imshow(np.sqrt(picture), cmap="magma", vmin=0, vmax=1)
        axes.set_title(title, fontsize=8.5)
    return figure


def _number(axis: Axis) -> None:
    """Plain numbers on a logarithmic axis."""
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
