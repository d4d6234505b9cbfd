"""``report.png``: for some captures, scene, mask, what left the camera, what a key opens, label."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from veilcam_optics.camera.geometry import Camera

PAPER, INK, FAINT, RIGHT, WRONG = "#0f1216", "#e8e6e1", "#7d8790", "#7fd1ae", "#f2786b"
FILTERS = np.array([[1.0, 0.42, 0.36], [0.45, 0.92, 0.5], [0.42, 0.62, 1.0]])
"""How the red, green and blue sub-pixels are drawn."""
CELL = (12, 36)
"""Drawn pixels per sub-pixel: the ratio of its sides."""
COLUMNS = (
    "scene",
    "mask on the panel",
    "embedding, as it leaves",
    "opened with the key",
    "label",
)


@dataclass(frozen=True, slots=True)
class Row:
    """One capture to draw."""

    image: npt.NDArray[np.uint8]
    levels: npt.NDArray[np.uint8] = field(repr=False)
    block: bytes = field(repr=False)
    """What left the camera: the embedding, sealed."""
    embedding: npt.NDArray[np.float32]
    """What a receiver makes of it with its key: the embedding as it was read."""
    scores: dict[str, float]
    truth: str


def write_report(path: Path, rows: Sequence[Row], camera: Camera, title: str, caption: str) -> None:
    """Draw ``rows`` one below the other and write the picture."""
    figure = Figure(figsize=(13.7, 1.35 + 2.05 * len(rows)), facecolor=PAPER, dpi=130)
    height = float(figure.get_figheight())
    grid = figure.add_gridspec(
        len(rows),
        len(COLUMNS),
        width_ratios=(1, 1.3, 1.34, 1.34, 1.35),
        left=0.03,
        right=0.97,
        top=1 - 1.25 / height,
        bottom=0.22 / height,
        wspace=0.14,
        hspace=0.13,
    )
    figure.text(0.03, 1 - 0.42 / height, title, color=INK, fontsize=19, weight="bold")
    figure.text(0.03, 1 - 0.74 / height, caption, color=FAINT, fontsize=10.5)
    for number, row in enumerate(rows):
        # Noise may be read as less than darkness.
        least = min(0.0, float(np.min(row.embedding)))
        axes = [figure.add_subplot(grid[number, column]) for column in range(len(COLUMNS))]
        if number == 0:
            for each, name in zip(axes, COLUMNS, strict=True):
                each.set_title(name, color=INK, fontsize=11, loc="left", pad=7)
        _image(axes[0], row.image, "gray", vmin=0, vmax=255)
        axes[1].imshow(draw_mask(row.levels, camera), interpolation="antialiased")
        _bare(axes[1])
        _image(axes[2], draw_block(row.block, row.embedding.shape), "gray", vmin=0, vmax=255)
        _image(axes[3], row.embedding, "magma", vmin=least, vmax=float(np.max(row.embedding)))
        _scores(axes[4], row)
    figure.savefig(path, facecolor=PAPER)


def draw_mask(levels: npt.NDArray[np.uint8], camera: Camera) -> npt.NDArray[np.float64]:
    """Return the panel as an image (rows, columns, 3): sub-pixels with filters and dead space."""
    panel = camera.panel
    share = (panel.aperture_y / panel.pitch_y, panel.aperture_x / panel.pitch_x)
    lit = [np.zeros(cell) for cell in CELL]
    for axis, cell, part in zip(lit, CELL, share, strict=True):
        margin = round(cell * (1 - part) / 2)
        axis[margin : cell - margin] = 1
    tiled = np.kron(levels / (panel.levels - 1), np.outer(lit[0], lit[1]))
    cycle = panel.filter_cycle
    rows = np.arange(len(levels)) + camera.window.first_row
    colours = FILTERS[np.array(cycle)[rows % len(cycle)]] if cycle else np.ones((len(levels), 3))
    return np.asarray(tiled[..., None] * np.repeat(colours, CELL[0], axis=0)[:, None, :])


def draw_block(block: bytes, shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
    """Return all bytes as an image about as wide as ``shape``; NaN where the last row has none."""
    rows = round(math.sqrt(len(block) * shape[0] / shape[1]))
    columns = math.ceil(len(block) / rows)
    drawn = np.full(rows * columns, np.nan)
    drawn[: len(block)] = np.frombuffer(block, np.uint8)
    return drawn.reshape(rows, columns)


def _scores(axes: Axes, row: Row) -> None:
    labels, values = list(row.scores), list(row.scores.values())
    best = int(np.argmax(values))
    colour = RIGHT if labels[best] == row.truth else WRONG
    bars = [colour if index == best else FAINT for index in range(len(labels))]
    axes.bar(range(len(labels)), values, color=bars, width=0.62)
    axes.set_xlim(-0.7, len(labels) + 3.2)
    axes.set_ylim(0, 1.08)
    axes.set_facecolor(PAPER)
    axes.set_xticks(range(len(labels)), labels, color=FAINT, fontsize=9)
    axes.set_yticks([])
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)
    centre = len(labels) + 1.3
    axes.text(
        centre,
        0.58,
        labels[best],
        color=colour,
        fontsize=38,
        weight="bold",
        ha="center",
        va="center",
    )
    note = f"{100 * values[best]:.0f} %" if labels[best] == row.truth else f"is a {row.truth}"
    axes.text(centre, 0.13, note, color=FAINT, fontsize=10, ha="center", va="center")


def _image(
    axes: Axes, values: npt.NDArray[np.generic], colours: str, *, vmin: float, vmax: float
) -> None:
    axes.imshow(values, cmap=colours, vmin=vmin, vmax=vmax or 1.0, interpolation="nearest")
    _bare(axes)


def _bare(axes: Axes) -> None:
    axes.set_facecolor(PAPER)
    axes.set_xticks([])
    axes.set_yticks([])
    for side in axes.spines.values():
        side.set_color(FAINT)
        side.set_linewidth(0.6)
