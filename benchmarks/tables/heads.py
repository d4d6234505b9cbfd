"""What the best head reads of drawn faces."""

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
        (f"faces_{task}_chance", f"{what}: the commoner answer, always"),
        (f"faces_{task}_best_24x32", f"{what}, ResNet16 behind a learned mask, 24 x 32"),
        (f"faces_{task}_best_24x32_low", "lower end of its interval"),
        (f"faces_{task}_best_24x32_high", "upper end of its interval"),
        (f"faces_{task}_pixels", f"{what}, ResNet8 on the picture of 64 x 52 pixels itself"),
    )
}
