"""What a sample of mutants says about the tests."""

from __future__ import annotations

from collections.abc import Sequence

from .results import Result
from .sample import Equivalent

BAR = 0.85
"""Least share of mutants that the tests of their own room kill."""


class Report:
    """Counts results and tells them.

    Args:
        results: of all mutants that were drawn.
        equivalents: those among them that no test can kill: told apart, and not counted. One that
            a test did kill is none, and counts.
        seed: that drew them.
    """

    def __init__(
        self, results: Sequence[Result], equivalents: Sequence[Equivalent], seed: int
    ) -> None:
        self._results, self._seed = results, seed
        self._reasons = {
            result.mutant: equivalent.reason
            for result in results
            for equivalent in equivalents
            if result.outcome == "survived" and equivalent.matches(result.mutant)
        }
        self._counted = [result for result in results if result.mutant not in self._reasons]

    @property
    def share(self) -> float:
        """Share of the mutants that were killed, in [0, 1]."""
        return _killed(self._counted) / max(1, len(self._counted))

    def render(self) -> str:
        """The report as Markdown."""
        counted = self._counted
        survivors = [result for result in counted if result.outcome == "survived"]
        lines = [
            f"# Mutants killed by their room: {_killed(counted)} of {len(counted)} "
            f"({self.share:.0%}, bar {BAR:.0%}, seed {self._seed})",
            "",
            "| subject | killed | of | timed out | equivalent |",
            "|---|---|---|---|---|",
            *self._table(),
            "",
            "## Survivors",
            *(line for result in survivors for line in _told(result)),
        ]
        if self._reasons:
            lines += ["", "## Equivalent, not counted"]
            for result in self._results:
                if result.mutant in self._reasons:
                    lines += [*_told(result), self._reasons[result.mutant]]
        return "\n".join(lines) + "\n"

    def _table(self) -> list[str]:
        rows = []
        for subject in dict.fromkeys(result.subject for result in self._results):
            own = [result for result in self._results if result.subject == subject]
            counted = [result for result in own if result.mutant not in self._reasons]
            late = sum(result.outcome == "timeout" for result in counted)
            cells = (_killed(counted), len(counted), late, len(own) - len(counted))
            rows.append(f"| {subject} | {' | '.join(map(str, cells))} |")
        return rows


def _killed(results: Sequence[Result]) -> int:
    return sum(result.outcome != "survived" for result in results)


def _told(result: Result) -> list[str]:
    mutant = result.mutant
    return [
        "",
        f"{mutant.file}:{mutant.line} {mutant.kind} ({result.outcome})",
        "```diff",
        f"- {mutant.before}",
        f"+ {mutant.after}",
        "```",
    ]
