"""Plans against exact light, over many jobs: one JSON line a job, and it goes on where it stopped.

    python -m tests.oracle.run --jobs 1000 --out build/oracle.jsonl \\
        --figures benchmarks/results/optics.json --chart docs/images/oracle.png
"""

from __future__ import annotations

import json
import math
import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import matplotlib as mpl
import numpy as np
import torch
import typer
from benchmarks.figures import FiguresOption, check_record, record

from .judge import Result, judge

LEAST_ERROR = 1e-7


def figures_of(results: Sequence[Result]) -> dict[str, float]:
    judged = [result for result in results if not result.unjudged]
    reached = [result.reached_ratio for result in judged if result.reached]
    sharp = [max(r.predicted, LEAST_ERROR) / max(r.true, LEAST_ERROR) for r in judged]
    reachable = [result for result in judged if result.reachable]
    found = {
        "oracle_jobs": len(results),
        "oracle_honest_fraction": _share(result.honest for result in judged),
        "fill_oracle_honest": _share(each.honest for each in judged if "fill" in each.effects),
        "oracle_worst_reached_ratio": max(reached, default=math.nan),
        "oracle_sharpness_median": statistics.median(sharp) if sharp else math.nan,
        "oracle_sharpness_95": float(np.quantile(sharp, 0.95)) if sharp else math.nan,
        "oracle_reached_fraction": _share(result.reached for result in reachable),
        "oracle_unjudged_fraction": 1 - len(judged) / len(results),
        "oracle_worst_time_over_best": max((r.time_over_best for r in judged), default=math.nan),
    }
    return {name: float(f"{value:.4g}") for name, value in found.items()}


def reasons(results: Sequence[Result]) -> Counter[str]:
    return Counter(result.unjudged for result in results if result.unjudged)


def draw_chart(results: Sequence[Result], path: Path) -> None:
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    judged = [result for result in results if not result.unjudged]
    figure, axes = plt.subplots(figsize=(6, 6), layout="constrained")
    for reached, name, colour in ((True, "reached", "tab:blue"), (False, "not reached", "0.6")):
        group = [result for result in judged if result.reached == reached]
        axes.scatter(
            [max(result.predicted, LEAST_ERROR) for result in group],
            [max(result.true, LEAST_ERROR) for result in group],
            s=10,
            color=colour,
            label=f"{name}: {len(group)}",
        )
    line = np.array([LEAST_ERROR / 2, 3])
    axes.plot(line, line, color="k", linewidth=0.8, label="as predicted")
    axes.plot(line, 2 * line, color="tab:red", linewidth=0.8, label="twice: honest below")
    axes.plot(line, line / 30, color="0.5", linewidth=0.8, linestyle="--", label="a thirtieth")
    axes.set(xscale="log", yscale="log", xlim=line, ylim=line)
    axes.set(xlabel="predicted error (relative L2)", ylabel="true error (relative L2)")
    axes.legend(loc="upper left", frameon=False)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def kept(path: Path) -> dict[int, Result]:
    found = {}
    for line in path.read_text().splitlines() if path.exists() else []:
        try:
            values = json.loads(line)
        except json.JSONDecodeError:
            continue
        values["effects"] = tuple(values["effects"])
        found[int(values["seed"])] = Result(**values)
    return found


def _share(verdicts: object) -> float:
    found = list(verdicts)  # type: ignore[call-overload]
    return sum(found) / len(found) if found else math.nan


def main(
    *,
    jobs: Annotated[int, typer.Option(min=1, help="How many, in the order of their seeds.")] = 1000,
    first: Annotated[int, typer.Option(help="The first seed.")] = 0,
    out: Annotated[Path, typer.Option(help="One JSON line a job; those there are kept.")] = Path(
        "build/oracle.jsonl"
    ),
    chart: Annotated[Path | None, typer.Option(help="Picture of all jobs to write.")] = None,
    figures: FiguresOption = None,
) -> None:
    """Judge plans by exact light."""
    torch.set_num_threads(1)
    if figures is not None:
        check_record(figures)
    out.parent.mkdir(parents=True, exist_ok=True)
    done = kept(out)
    seeds = range(first, first + jobs)
    with out.open("a") as file:
        if out.stat().st_size and not out.read_text().endswith("\n"):
            file.write("\n")
        for seed in seeds:
            if seed not in done:
                done[seed] = judge(seed)
                file.write(json.dumps(asdict(done[seed])) + "\n")
                file.flush()
    results = [done[seed] for seed in seeds]
    found = figures_of(results)
    for name, value in found.items():
        typer.echo(f"{name:28} {value}")
    for reason, count in reasons(results).items():
        typer.echo(f"{'not judged':28} {count}: {reason}")
    typer.echo(f"{'too large for the oracle':28} {sum(r.unaffordable for r in results)} more draws")
    if chart is not None:
        draw_chart(results, chart)
    record(figures, found)


if __name__ == "__main__":
    typer.run(main)
