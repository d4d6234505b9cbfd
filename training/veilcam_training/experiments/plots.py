"""The pictures of a report: cost, curves, PSFs, embeddings, confusion matrices."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from veilcam_training.experiments.cost import draw_cost
from veilcam_training.experiments.pictures import Pixels, load_pictures
from veilcam_training.experiments.results import PICTURES, Entry, Summary, cell_folder
from veilcam_training.experiments.style import COLOURS, NAMES, bare, encoder_title, panels_of, tidy


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
            "from a reading to a label (one thread, one reading at a time, median).",
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


def draw_curves(summary: Summary) -> Figure:
    """A panel for each classifier and column, a line for each encoder."""
    entries = summary.finished()
    classifiers = list(dict.fromkeys(entry.place.row.classifier for entry in entries))
    columns = [c for c in summary.columns if any(entry.place.column == c for entry in entries)]
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
        linestyle="--" if row.reading == "point" else "-",
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
        if row.encoder == "digital" or (row.encoder != "learned" and row.reading == "point"):
            continue
        title = encoder_title(row)
        if row.encoder == "learned":
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
    classifier = entries[0].place.row.classifier
    rows = [row for row in summary.rows if row.classifier == classifier]
    rows = [row for row in rows if any(entry.place.row == row for entry in entries)]
    columns = [c for c in summary.columns if any(entry.place.column == c for entry in entries)]
    figure, panels = panels_of(len(rows), 1 + len(columns), (1.7, 1.5))
    for axes_row, row in zip(panels, rows, strict=True):
        for axes in axes_row:
            bare(axes)
        axes_row[0].set_ylabel(
            encoder_title(row).replace(", ", "\n"), rotation=0, ha="right", va="center", fontsize=9
        )
        for axes, column in zip(axes_row[1:], columns, strict=True):
            entry = summary.find(row, column)
            if entry is None:
                axes.set_axis_off()
                continue
            pictures = load_pictures(_pictures(entry, work))
            axes.imshow(pictures.embeddings[0], cmap="magma", vmin=0, vmax=1)
            if not axes_row[0].images:
                axes_row[0].imshow(pictures.scenes[0], cmap="gray", vmin=0, vmax=1)
    panels[0][0].set_title("scene", fontsize=9.5)
    for axes, column in zip(panels[0][1:], columns, strict=True):
        axes.set_title(summary.table.column_title(column), fontsize=9.5)
    return figure


def draw_confusion(summary: Summary, classifier: str) -> Figure:
    """A matrix for each encoder and column."""
    entries = [e for e in summary.finished() if e.place.row.classifier == classifier]
    rows = [row for row in summary.rows if any(entry.place.row == row for entry in entries)]
    columns = [c for c in summary.columns if any(entry.place.column == c for entry in entries)]
    figure, panels = panels_of(len(rows), len(columns), (1.8, 1.8))
    for axes_row, row in zip(panels, rows, strict=True):
        for axes, column in zip(axes_row, columns, strict=True):
            bare(axes)
            entry = summary.find(row, column)
            if entry is None:
                axes.set_axis_off()
                continue
            matrix = np.array(entry.results[0].confusion, dtype=float)
            matrix /= np.maximum(matrix.sum(1, keepdims=True), 1)
            np.fill_diagonal(matrix, 0)
            axes.imshow(np.sqrt(matrix), cmap="Purples", vmin=0, vmax=0.7)
            axes.set_xlabel(f"{entry.test:.1f} %", fontsize=8.5, labelpad=2)
        axes_row[0].set_ylabel(
            encoder_title(row).replace(", ", "\n"), rotation=0, ha="right", va="center", fontsize=9
        )
        axes_row[0].set_axis_on()
    for axes, column in zip(panels[0], columns, strict=True):
        axes.set_title(summary.table.column_title(column), fontsize=9.5)
    return figure


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
