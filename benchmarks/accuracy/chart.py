"""Error against time, log-log, with the Pareto front."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from benchmarks.accuracy.measure import OURS, Point, pareto_front
from benchmarks.accuracy.report import Result, duration
from benchmarks.accuracy.transfer_job import PLAN

WORST_ERROR = 1.5
"""Larger errors are not drawn: the result has nothing to do with the truth."""

_OURS = {
    "transfer operator": ("#0b7a5b", "o"),
    "factored field": ("#1f6fb5", "s"),
    "angular spectrum": ("#6a4fb3", "^"),
    "fresnel transfer function": ("#4aa3a2", "v"),
    "fresnel impulse response": ("#8fb339", "D"),
    "geometric shadow": ("#5c5c5c", ">"),
    "rayleigh-sommerfeld": ("#2f4858", "h"),
    "Algorithm 1": ("#8c510a", "p"),
    PLAN: ("#111111", "*"),
}
_LABELS = {PLAN: "the plan's own choice, by tolerance"}
_PEERS = (
    ("#d1495b", "X"),
    ("#e76f2e", "P"),
    ("#edae49", "d"),
    ("#b5838d", "p"),
    ("#c77d2b", "H"),
    ("#a4243b", "8"),
)


def draw(path: Path, results: Sequence[Result]) -> None:
    """Write one picture with a panel for each job.

    Args:
        path: of the picture; its suffix chooses the format.
        results: at least one.
    """
    with mpl.rc_context({"font.size": 10, "axes.titlesize": 11, "svg.hashsalt": "veilcam"}):
        figure = Figure(figsize=(6.4 * len(results), 6.6), layout="constrained")
        panels = figure.subplots(1, len(results), squeeze=False)[0]
        for axes, result in zip(panels, results, strict=True):
            _panel(axes, result)
        figure.savefig(path, dpi=160, facecolor="white")


def _panel(axes: Axes, result: Result) -> None:
    """One job: its points, their Pareto front and the legend."""
    points = [point for point in result.points if 0 < point.error <= WORST_ERROR]
    axes.set(xscale="log", yscale="log", title=result.title)
    axes.set_xlabel("time of one run, one thread")
    axes.set_ylabel("error (relative L2)")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: duration(value)))
    axes.grid(which="major", color="#dddddd", linewidth=0.8)
    axes.grid(which="minor", color="#f1f1f1", linewidth=0.5)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)

    front = pareto_front(points)
    if front:
        axes.plot(
            [point.seconds for point in front],
            [point.error for point in front],
            color="#222222",
            linewidth=1.6,
            linestyle=(0, (5, 2)),
            drawstyle="steps-post",
            zorder=2.5,
            label="Pareto front",
        )
    styles = _styles(points)
    for method, (colour, marker) in styles.items():
        own = [point for point in points if point.method == method]
        for precision, filled in (("float64", False), ("float32", True), ("", True)):
            some = [p for p in own if p.dials.get("dtype", "") == precision]
            some.sort(key=lambda p: p.seconds)
            # One point's label stands for the method in the legend, whichever precision is there.
            _series(axes, some, colour, marker, filled=filled)
        axes.plot([], [], marker, color=colour, markersize=8, label=_LABELS.get(method, method))
    for point in points:
        if point.method == PLAN:
            axes.annotate(
                f"asked {float(point.dials['tolerance']):.0e}".replace("e-0", "e-"),
                (point.seconds, point.error),
                xytext=(-9, 0),
                textcoords="offset points",
                horizontalalignment="right",
                verticalalignment="center",
                fontsize=8,
            )
    if PLAN in styles:
        left, right = axes.get_xlim()
        axes.set_xlim(left / 4, right)  # room for what was asked
    axes.plot([], [], "o", color="#777777", markersize=7, label="filled: float32")
    axes.plot(
        [], [], "o", markerfacecolor="white", markeredgecolor="#777777", label="hollow: float64"
    )
    if not all(point.supported for point in points):
        axes.plot([], [], "o", color="#777777", alpha=0.3, label="faint: outside its stated range")
    axes.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, -0.13),
        ncols=2,
        frameon=False,
        fontsize=8.5,
        handletextpad=0.5,
    )


def _series(axes: Axes, points: Sequence[Point], colour: str, marker: str, *, filled: bool) -> None:
    """The points of one method in one precision, and lines along its sampling."""
    # A line leads along the sampling, everything else alike.
    lines: dict[frozenset[object], list[Point]] = {}
    for point in points:
        rest = frozenset(item for item in point.dials.items() if item[0] != "oversampling")
        lines.setdefault(rest, []).append(point)
    for line in lines.values():
        axes.plot(
            [point.seconds for point in line],
            [point.error for point in line],
            color=colour,
            linewidth=0.7,
            alpha=0.35,
            zorder=2,
        )
    for point in points:
        axes.plot(
            point.seconds,
            point.error,
            marker,
            markersize=15 if point.method == PLAN else 8,
            markerfacecolor=colour if filled else "white",
            markeredgecolor="white" if filled else colour,
            markeredgewidth=0.8 if filled else 1.6,
            alpha=1.0 if point.supported else 0.3,
            zorder=4 if point.method == PLAN else 3,
        )


def _styles(points: Sequence[Point]) -> dict[str, tuple[str, str]]:
    """Colour and marker of each method: ours by name, the others' in turn."""
    styles: dict[str, tuple[str, str]] = {}
    peers = iter(_PEERS * 4)
    for point in sorted(points, key=lambda p: (p.source != OURS, p.source, p.method)):
        if point.method not in styles:
            own = _OURS.get(point.method) if point.source == OURS else None
            styles[point.method] = own or next(peers)
    return styles
