"""What scene classifiers read, and what reading costs."""

from __future__ import annotations

from benchmarks.tables.table import Figures

CELLS_READ: Figures = {
    key: ("data", words, pattern)
    for name, what in (
        ("cifar10_hidden_27x36", "CIFAR-10 behind a hidden mask, 27 x 36"),
        ("cifar10_hidden_6x8", "CIFAR-10 behind a hidden mask, 6 x 8"),
        ("cifar10_fresh_27x36", "CIFAR-10 behind fresh masks, 27 x 36"),
        ("mnist_hidden_24x32", "MNIST behind a hidden mask, 24 x 32"),
        ("mnist_hidden_3x4", "MNIST behind a learned mask, 3 x 4"),
    )
    for key, words, pattern in (
        (name, f"{what}, mean of the seeds", "{:.2f} %"),
        (f"{name}_interval", "half of its interval (95 %)", "{:.2f} %"),
        (f"{name}_core_minutes", "time of a fit, one core", "{:.1f} min"),
    )
} | {
    "head_numpy_ms": ("data", "reading one picture in colour in NumPy, 27 x 36", "{:.1f} ms"),
    "fresh_colour_prepare_s": ("data", "preparing a fresh mask in colour, 27 x 36", "{:.2f} s"),
}
