"""Accuracy against cost: accuracy, size, training time and inference time on one chart."""

from __future__ import annotations

import math

from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator

from veilcam_training.experiments.results import Entry, Summary
from veilcam_training.experiments.style import MARKERS, NAMES, tidy

POINT_EDGE, EDGE = "#d1495b", "#333333"
LEAST_ERROR = 0.05
"""Percent: less has no place on a logarithmic axis."""
ACCURACIES = (10, 30, 50, 60, 70, 80, 90, 95, 98, 99, 99.5, 99.8)


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
            edgecolors=POINT_EDGE if row.reading == "point" else EDGE,
            linewidths=1.5 if row.reading == "point" else 0.6,
            zorder=3,
        )
    axes.set(xscale="log", xlabel="training, all epochs [s]")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    # What is left to gain is the error: on its logarithm 98 and 99 % are as far apart as 80 and 90.
    axes.set(yscale="log", ylabel="test accuracy [%]")
    axes.invert_yaxis()
    axes.yaxis.set_major_locator(FixedLocator([100 - accuracy for accuracy in ACCURACIES]))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 - value:g}"))
    axes.yaxis.set_minor_locator(NullLocator())
    tidy(axes)
    bar = figure.colorbar(points, ax=axes, label="reading to label [µs]", pad=0.02)
    bar.ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    bar.ax.yaxis.set_minor_formatter(NullFormatter())
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
    return math.prod(map(int, embedding.split("x")))


def _legend(entries: list[Entry]) -> list[Line2D]:
    encoders = dict.fromkeys(entry.place.row.encoder for entry in entries)
    handles = [_handle(NAMES[name], MARKERS[name], "#777777", 7) for name in encoders]
    if any(entry.place.row.reading == "point" for entry in entries):
        handles.append(_handle("red edge: point reading", "o", "white", 7, edge=POINT_EDGE))
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
