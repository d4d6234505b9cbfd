"""Figures of a run: shares and their intervals, the worst camera, and the curve of shifts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
from benchmarks.proof.captures import LEVELS, Level
from benchmarks.proof.faults import FAULTS
from benchmarks.proof.runs import Tally
from matplotlib.figure import Figure
from scipy.stats import beta

from veilcam_optics.proof import Verdict

VERDICTS: tuple[Verdict, ...] = ("seen", "not seen", "undecided")
BRIGHTER = LEVELS[:2]


@dataclass(frozen=True)
class Counts:
    """How many captures got which verdict."""

    seen: int
    accused: int
    undecided: int

    @classmethod
    def of(cls, tallies: Iterable[Tally], state: str, levels: Sequence[Level]) -> Counts:
        """Of one state of the panel, in some light."""
        total: Counter[str] = Counter()
        for tally in tallies:
            total.update(tally.verdicts)
        return cls(
            *(sum(total[f"{state}/{level}/{verdict}"] for level in levels) for verdict in VERDICTS)
        )

    @property
    def captures(self) -> int:
        """All of them."""
        return self.seen + self.accused + self.undecided


def upper_end(events: int, trials: int, confidence: float = 0.95) -> float:
    """Upper end of the two-sided interval of a share (Clopper and Pearson 1934).

    It takes captures to be independent of each other.
    """
    if events >= trials:
        return 1.0
    return float(beta.ppf((1 + confidence) / 2, events + 1, trials - events))


def healthy_figures(tallies: Sequence[Tally]) -> dict[str, float]:
    """Figures of healthy cameras."""
    counts, worst = Counts.of(tallies, "healthy", LEVELS), worst_camera(tallies)
    brighter = Counts.of(tallies, "healthy", BRIGHTER)
    return {
        "healthy_captures": counts.captures,
        "cameras": len(tallies),
        "false_alarms": counts.accused,
        "false_alarms_upper95": upper_end(counts.accused, counts.captures),
        "undecided_fraction": brighter.undecided / brighter.captures,
        "worst_camera": worst.job["number"],
        "worst_camera_false_alarms": Counts.of([worst], "healthy", LEVELS).accused,
        "worst_camera_least_margin": round(min(worst.least_margin.values()), 1),
    }


def worst_camera(tallies: Sequence[Tally]) -> Tally:
    """The one with most false alarms, or else the one that came closest to one."""

    def order(tally: Tally) -> tuple[int, float]:
        return -Counts.of([tally], "healthy", LEVELS).accused, min(tally.least_margin.values())

    return min(tallies, key=order)


def fault_table(tallies: Sequence[Tally]) -> dict[tuple[str, str, Level], Counts]:
    """Counts by bundle, fault and level."""
    return {
        (bundle, fault, level): Counts.of(
            [tally for tally in tallies if tally.job["bundle"] == bundle], fault, [level]
        )
        for bundle in sorted({tally.job["bundle"] for tally in tallies})
        for fault in FAULTS
        for level in LEVELS
    }


def fault_figures(table: Mapping[tuple[str, str, Level], Counts]) -> dict[str, float]:
    """Figures of faults: of the worst bundle, fault and level, and of each fault in bright light.

    An opaque panel cannot be told from a dark room, and is not among the faults to be found.
    """
    told = {place: counts for place, counts in table.items() if place[1] != "opaque"}
    values: dict[str, float] = {
        "fault_captures": sum(counts.captures for counts in table.values()),
        "fault_found_first_capture": min(each.accused / each.captures for each in told.values()),
        "fault_seen_first_capture": max(each.seen / each.captures for each in table.values()),
    }
    for fault in FAULTS:
        bright = [
            counts
            for (_, name, level), counts in told.items()
            if (name, level) == (fault, "bright")
        ]
        if bright:
            values[f"fault_found_bright_{fault}"] = min(
                each.accused / each.captures for each in bright
            )
    return values


def shift_curve(
    tallies: Sequence[Tally], along: str, level: Level
) -> tuple[list[int], list[Counts]]:
    """Counts by how many lines a mask is shifted.

    Args:
        tallies: of faulty cameras.
        along: ``rows`` or ``columns``.
        level: of the light.
    """
    lines = [-3, -2, -1, 1, 2, 3]
    states = [f"shifted {line} 0" if along == "rows" else f"shifted 0 {line}" for line in lines]
    return lines, [Counts.of(tallies, state, [level]) for state in states]


def draw_shifts(tallies: Sequence[Tally], path: Path) -> None:
    """Draw how often a shifted mask is found."""
    with mpl.rc_context({"svg.hashsalt": "veilcam"}):
        figure = Figure(figsize=(8, 3.4), layout="constrained")
        for axes, along in zip(
            figure.subplots(1, 2, sharey=True), ("rows", "columns"), strict=True
        ):
            for level, marker in zip(LEVELS, "os^", strict=True):
                lines, counts = shift_curve(tallies, along, level)
                found = [100 * each.accused / each.captures for each in counts]
                axes.plot(lines, found, marker=marker, label=level)
            axes.set(xlabel=f"mask shifted by {along}", xticks=lines, ylim=(-3, 103))
            axes.grid(alpha=0.3)
        figure.axes[0].set_ylabel("found in the first capture [%]")
        figure.axes[1].legend(title="light")
        figure.savefig(path, dpi=120)
