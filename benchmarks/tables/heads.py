"""What heads read: the best one of drawn faces, and LR of twelve numbers."""

from __future__ import annotations

from benchmarks.tables.table import Figures

HEADS: Figures = {
    key: ("data", words, "{:.2f} %")
    for task, what in (
        ("glasses", "glasses"),
        ("gender", "gender"),
        ("smiling", "smile"),
    )
    for key, words in (
        (f"faces_{task}_chance", f"{what}: always what is commoner in the training set"),
        (f"faces_{task}_best_24x32", f"{what}, ResNet16 behind a learned mask, 24 x 32"),
        (f"faces_{task}_best_24x32_low", "lower end of its interval"),
        (f"faces_{task}_best_24x32_high", "upper end of its interval"),
        (f"faces_{task}_pixels", f"{what}, ResNet8 on the picture of 64 x 52 pixels itself"),
    )
} | {
    "mnist_LR_3x4": ("data", "MNIST, LR behind the best of four learned masks, 3 x 4", "{:.2f} %"),
    "mnist_LR_3x4_low": ("data", "lower end of its interval", "{:.2f} %"),
    "mnist_LR_3x4_high": ("data", "upper end of its interval", "{:.2f} %"),
}
