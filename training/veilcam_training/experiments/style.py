"""How encoders look in the pictures of a report, and what all its pictures have in common."""

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from veilcam_training.encoders import ENCODERS
from veilcam_training.experiments.grid import Row

COLOURS: Mapping[str, str] = dict(
    zip(
        ENCODERS,
        ("#9a9a9a", "#c77d2b", "#4aa3a2", "#8a6fc4", "#1f6fb5", "#d1495b", "#222222"),
        strict=True,
    )
)
MARKERS: Mapping[str, str] = dict(zip(ENCODERS, "ovDPs*X", strict=True))
NAMES: Mapping[str, str] = {
    "lens": "lens",
    "coded_aperture": "coded aperture",
    "diffuser": "diffuser",
    "fixed_measured": "fixed mask, measured",
    "fixed_simulated": "fixed mask, simulated",
    "learned": "learned mask",
    "digital": "digital (ceiling)",
}
GRID = "#e4e4e4"


def encoder_title(row: Row) -> str:
    """What an encoder is called in a report."""
    return NAMES[row.encoder] + (", point binning" if row.binning == "point" else "")


def panels_of(down: int, across: int, size: tuple[float, float]) -> tuple[Figure, list[list[Axes]]]:
    """A figure with ``down`` rows of ``across`` panels of ``size`` (width, height) [inches]."""
    width, height = max(size[0] * across, 4), size[1] * down + 0.5
    figure = Figure(figsize=(width, height), layout="constrained")
    panels = figure.subplots(down, across, squeeze=False)
    return figure, [list(row) for row in panels]


def bare(axes: Axes) -> None:
    """Leave the picture alone."""
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)


def tidy(axes: Axes) -> None:
    """A light grid, and no box."""
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
