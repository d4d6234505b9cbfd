"""One table of figures in Markdown, from ``benchmarks/results``."""

from __future__ import annotations

import json
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

Figures = dict[str, tuple[str, str, str]]
"""In which file a figure stands, what it is in words, and how it is shown."""


def table(shown: Figures) -> str:
    """One table in Markdown; figures that were not measured yet are left out.

    A command that is that of the row above is not said again.
    """
    lines = ["| what | measured | command |", "|---|---|---|"]
    above = None
    for name, (file, words, pattern) in shown.items():
        path = ROOT / "benchmarks" / "results" / f"{file}.json"
        figures = json.loads(path.read_text()) if path.exists() else {}
        if name in figures:
            value, command = pattern.format(figures[name]["value"]), figures[name]["command"]
            said = "as above" if command == above else f"`{command}`"
            lines.append(f"| {words} | {value} | {said} |")
            above = command
    return "\n".join(lines) + "\n"
