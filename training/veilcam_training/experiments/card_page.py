"""``card.html``: a privacy card to be read, with a picture of what an attacker sees."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from veilcam_training.attacks.card.study import Study
from veilcam_training.attacks.card.threats import CLAIMED
from veilcam_training.bundle import CardRow, PrivacyCard
from veilcam_training.experiments.pages import embedded, page, png

Floats = npt.NDArray[np.float32]

SHOWN = 6
"""Pictures in a row."""
_DIGITS = {"|AUC - 1/2|": 3, "dB": 1}


def write_page(card: PrivacyCard, pictures: bytes) -> str:
    """Return the page, whole: it needs no other file and nothing of the network.

    Args:
        card: is shown.
        pictures: PNG of :func:`draw_pictures`.
    """
    claimed, source = CLAIMED[card.form], embedded(pictures)
    return page("card", card=card, pictures=source, claimed=claimed, place=place, number=number)


def number(value: float, unit: str) -> str:
    """Return a figure as it is read: few digits, a true minus sign."""
    return f"{value:.{_DIGITS.get(unit, 1)}f}".replace("-", "−").replace("−0.0", "0.0")


def place(row: CardRow, value: float) -> float:
    """Return the place of a value on a row's scale [%]: from chance to all, roots of both.

    Roots, so that a threshold near chance and a figure near certainty fit on one line.
    """
    whole = {"%": 100.0, "points": 90.0, "|AUC - 1/2|": 0.5, "dB": 20.0}[row.unit]
    share = (value - (row.chance if row.unit == "%" else 0.0)) / whole
    return round(100 * math.sqrt(min(max(share, 0.0), 1.0)), 1)


def draw_pictures(study: Study) -> bytes:
    """PNG: scenes, what leaves of them, and what attackers make of that; a column for each."""
    seen, shape = study.seen, study.subject.bundle.embedding.shape
    # Of masks that follow each other: the first capture of each second one.
    masks = range(0, min(2 * SHOWN, seen.masks), 2)
    truth = study.ours.scenes(seen.chosen[:, 0])
    rows: Sequence[tuple[str, Tensor, bool]] = (
        ("scene", truth, True),
        ("what leaves", seen.released[:, 0], False),
        ("wrong key", seen.wrong[:, 0], True),
        ("leaked list", seen.listed[:, 0], True),
        ("with the key", seen.right[:, 0], True),
    )
    figure, panels = panels_of(len(rows), len(masks), (0.9, 0.8))
    figure.set_layout_engine("constrained", h_pad=0.02, w_pad=0.02)
    for axes_row, (title, values, is_scene) in zip(panels, rows, strict=True):
        for axes, mask in zip(axes_row, masks, strict=True):
            bare(axes)
            picture = values[mask].numpy()
            if is_scene:
                axes.imshow(picture, cmap="gray", vmin=0, vmax=1)
            else:
                axes.imshow(_as_picture(picture, shape), cmap="magma")
        axes_row[0].set_ylabel(title, rotation=0, ha="right", va="center", fontsize=13)
    return png(figure, 200)


def panels_of(down: int, across: int, size: tuple[float, float]) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure with rows of panels of ``size`` (width, height) [inches]."""
    width, height = max(size[0] * across, 4), size[1] * down + 0.5
    figure = Figure(figsize=(width, height), layout="constrained")
    panels = figure.subplots(down, across, squeeze=False)
    return figure, [list(row) for row in panels]


def bare(axes: Axes) -> None:
    """Take ticks and frame from a picture."""
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)


def _as_picture(values: Floats, shape: tuple[int, int]) -> Floats:
    """Numbers as they came, row by row; a block of bytes as nearly square as it goes."""
    if values.size == shape[0] * shape[1]:
        return values.reshape(shape)
    columns = math.ceil(math.sqrt(values.size * shape[1] / shape[0]))
    rows = math.ceil(values.size / columns)
    return np.pad(values, (0, rows * columns - values.size)).reshape(rows, columns)
