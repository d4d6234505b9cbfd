"""Pictures of what an attacker sees, as in the paper's figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from veilcam_training.experiments.card_page import bare, panels_of


def draw(path: Path, titles: Sequence[str], columns: Sequence[Tensor]) -> None:
    """One row for each scene, one column for each attacker.

    Args:
        path: of the PNG.
        titles: of the columns.
        columns: (count, rows, columns) each, in [0, 1].
    """
    count = len(columns[0])
    figure, panels = panels_of(count, len(columns), (1.15, 1.35))
    for place, (title, column) in enumerate(zip(titles, columns, strict=True)):
        for line in range(count):
            axes = panels[line][place]
            axes.imshow(column[line].numpy(), cmap="gray", vmin=0, vmax=1)
            bare(axes)
            if line == 0:
                axes.set_title(title, fontsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def kept(pictures: list[list[list[int]]]) -> Tensor:
    """Pictures of a cell, as they are drawn."""
    return torch.tensor(pictures) / 255
