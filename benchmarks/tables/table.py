"""One table of figures in Markdown, from ``benchmarks/results``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

Figures = dict[str, tuple[str, str, str]]
"""In which file a figure stands, what it is in words, and how it is shown."""


def measured(file: str) -> Mapping[str, Mapping[str, str | float]]:
    """Read a record of ``benchmarks/results``; it is empty while nothing was measured."""
    path = ROOT / "benchmarks" / "results" / f"{file}.json"
    found: dict[str, dict[str, str | float]] = json.loads(path.read_text()) if path.exists() else {}
    return found


def table(shown: Figures) -> str:
    """One table in Markdown; figures that were not measured yet are left out.

    A command that is that of the row above is not said again.
    """
    lines = ["| what | measured | command |", "|---|---|---|"]
    above = None
    for name, (file, words, pattern) in shown.items():
        if figure := measured(file).get(name):
            said = "as above" if figure["command"] == above else f"`{figure['command']}`"
            lines.append(f"| {words} | {pattern.format(figure['value'])} | {said} |")
            above = figure["command"]
    return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class Grid:
    """Table of one record, a row a thing and a column a figure of it; called, it is Markdown.

    Attributes:
        file: record.
        what: heading of the rows.
        rows: words of each row by its key.
        columns: heading and pattern of each column by the figures' name, with ``{}`` for the key.
        paper: values of the paper by the figures' name, shown in brackets.
    """

    file: str
    what: str
    rows: Mapping[str, str]
    columns: Mapping[str, tuple[str, str]]
    paper: Mapping[str, float] = field(default_factory=dict)

    def __call__(self) -> str:
        """Return the table; it says a command that is that of the row above not again."""
        figures = measured(self.file)
        heads = [self.what, *(words for words, _ in self.columns.values()), "command"]
        lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
        above = None
        for key, words in self.rows.items():
            cells, commands = [words], set[str]()
            for column, (_, pattern) in self.columns.items():
                name = column.format(key)
                figure = figures.get(name)
                beside = f" ({pattern.format(self.paper[name])})" if name in self.paper else ""
                cells.append(pattern.format(figure["value"]) + beside if figure else "")
                commands |= {str(figure["command"])} if figure else set()
            (command,) = commands
            cells.append("as above" if command == above else f"`{command}`")
            lines.append(f"| {' | '.join(cells)} |")
            above = command
        return "\n".join(lines) + "\n"
