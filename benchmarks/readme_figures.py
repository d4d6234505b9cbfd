"""Write the README's table of figures from ``benchmarks/results``, so that it cannot go stale.

python benchmarks/readme_figures.py
"""

from __future__ import annotations

import json
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BEGIN, END = "<!-- figures -->\n", "<!-- end of figures -->"

# What a figure is called in words, how it is shown, and in which file it stands.
SHOWN: dict[str, tuple[str, str, str]] = {
    "demo_accuracy": ("main-job", "demo: held-out digits read right through six masks", "{:.3f}"),
    "demo_wrong_classifier_accuracy": (
        "main-job",
        "the same with the classifier of another mask",
        "{:.3f}",
    ),
    "mnist_lr_learned_24x32": (
        "main-job",
        "MNIST test accuracy, learned mask, linear classifier, 24 x 32",
        "{:.2f} %",
    ),
    "step_ratio_learned_over_fixed": (
        "main-job",
        "training step with a learned mask, over one with a fixed mask",
        "{:.2f} x",
    ),
    "transfer_error_24x32": (
        "main-job",
        "transfer operator against the whole field, 16 times oversampled",
        "{:.1e}",
    ),
    "transfer_time_waveprop_over_ours": (
        "optics",
        "mask to 24 x 32 embedding: waveprop's time over ours",
        "{:.0f} x",
    ),
    "step_time_waveprop_over_ours": (
        "optics",
        "learned-mask training step: waveprop's time over ours",
        "{:.0f} x",
    ),
    "step_peak_rss_mb": ("optics", "memory of that step, at its peak", "{:.0f} MB"),
    "plan_honest_fraction": (
        "optics",
        "plans whose measured error is at most twice the predicted one",
        "{:.3f}",
    ),
    "plan_worst_time_over_best": (
        "optics",
        "a plan's time over the fastest setting's, at worst",
        "{:.2f} x",
    ),
}


def table() -> str:
    """The table in Markdown; figures that were not measured yet are left out."""
    lines = ["| what | measured | command |", "|---|---|---|"]
    for name, (file, words, pattern) in SHOWN.items():
        path = ROOT / "benchmarks" / "results" / f"{file}.json"
        figures = json.loads(path.read_text()) if path.exists() else {}
        if name in figures:
            value = pattern.format(figures[name]["value"])
            lines.append(f"| {words} | {value} | `{figures[name]['command']}` |")
    return "\n".join(lines) + "\n"


def with_table(readme: str) -> str:
    """The README with its table replaced."""
    before, rest = readme.split(BEGIN)
    return before + BEGIN + table() + END + rest.split(END)[1]


def main() -> None:
    """Rewrite README.md."""
    path = ROOT / "README.md"
    path.write_text(with_table(path.read_text()))


if __name__ == "__main__":
    main()
