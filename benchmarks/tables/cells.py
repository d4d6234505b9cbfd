"""What scene classifiers read, and what reading costs."""

from __future__ import annotations

from benchmarks.tables.table import Figures

CELLS_READ: Figures = {
    "mnist_fixed_6x8_fill": (
        "data",
        "MNIST behind a fixed mask, 6 x 8, fill .1, FC-800, noise of photons",
        "{:.2f} %",
    ),
    "mnist_fixed_6x8_fill_40db": ("data", "the same, noise at 40 dB", "{:.2f} %"),
    "fill_oracle_honest": ("data", "honest plans of light, of jobs with a fill below 1", "{:.3f}"),
    "head_numpy_ms": ("data", "reading one picture in colour in NumPy, 27 x 36", "{:.1f} ms"),
    "fresh_colour_prepare_s": ("data", "preparing a fresh mask in colour, 27 x 36", "{:.2f} s"),
}
OWN_PICTURES: Figures = {
    "budget_kept_ratio": (
        "data",
        "fit of 5,000 photographs, 27 x 36, `--budget 3m`: processor time over the budget",
        "{:.2f}",
    ),
    "photographs_accuracy": ("data", "the same: 200 test photographs read right", "{:.1f} %"),
    "photographs_agreement": (
        "data",
        "the same: labels of `predict` that the daemon gives, too",
        "{:.1f} %",
    ),
    "resume_identical": (
        "data",
        "the same: killed three times and resumed, 1 if the result is equal",
        "{:.0f}",
    ),
}
"""Fit of 5,000 photographs in colour, ten classes, 27 x 36."""
