"""Looks of encoders in the pictures of a report."""

from collections.abc import Mapping

from matplotlib.axes import Axes

from benchmarks.paper.grid import CAMERAS, Row

COLOURS: Mapping[str, str] = dict(
    zip(
        CAMERAS,
        (
            *("#9a9a9a", "#c77d2b", "#4aa3a2", "#8a6fc4", "#1f6fb5", "#d1495b", "#222222"),
            *("#6a994e", "#e0a400"),
        ),
        strict=True,
    )
)
MARKERS: Mapping[str, str] = dict(zip(CAMERAS, "ovDPs*X^p", strict=True))
NAMES: Mapping[str, str] = {
    "lens": "lens",
    "coded_aperture": "coded aperture",
    "diffuser": "diffuser",
    "fixed_measured": "fixed mask, measured",
    "fixed_simulated": "fixed mask, simulated",
    "learned": "learned mask, no bound",
    "digital": "digital (ceiling)",
    "hidden": "learned mask within the bound",
    "fresh": "fresh masks",
}
GRID = "#e4e4e4"


def encoder_title(row: Row) -> str:
    """What an encoder is called in a report."""
    return NAMES[row.encoder] + (", point binning" if row.binning == "point" else "")


def tidy(axes: Axes) -> None:
    """A light grid, and no box."""
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
