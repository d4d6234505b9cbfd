"""Plans against exact light, over many jobs: one JSON line a job, and it goes on where it stopped.

    python -m tests.oracle.run --jobs 1000 --out build/oracle.jsonl \\
        --figures benchmarks/results/optics.json
"""

from __future__ import annotations

import json
import math
import statistics
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer

from veilcam_optics.errors import OpticsError
from veilcam_optics.plan import Plan, plan
from veilcam_training.experiments.records import check_record, record_figures

from .jobs import Job, draw, light, masks, scattered, shown
from .physics import Array, transfer

UNSURE = 0.3
"""An oracle that is itself this share of the plan's error off cannot judge it."""


@dataclass(frozen=True)
class Result:
    """What came of one job."""

    seed: int
    tolerance: float
    predicted: float
    true: float
    reached: bool
    oracle_error: float
    """Of one scene pixel, against cells half as wide: relative L2."""
    method: str
    effects: tuple[str, ...]
    plan_seconds: float
    oracle_seconds: float
    refused: str = ""

    @property
    def judged(self) -> bool:
        """Whether the oracle is surer than the plan."""
        return not self.refused and self.oracle_error <= UNSURE * max(self.predicted, self.true)

    @property
    def honest(self) -> bool:
        """Whether the true error is at most twice the predicted one."""
        return self.true <= 2 * self.predicted

    @property
    def reached_ratio(self) -> float:
        """True error over what a plan that says "reached" promises."""
        return self.true / max(self.predicted, self.tolerance / 10)


def truth(job: Job, weights: Array) -> tuple[Array, float]:
    """Exact transfers of masks, and how far they are from those of cells half as wide."""
    optics, amplitudes = light(job), shown(job, weights)
    exact = transfer(optics, amplitudes)
    fine = transfer(optics, amplitudes[:1], finer=2, only=(0, 0))
    size = float(np.linalg.norm(fine)) or 1.0
    return scattered(job, exact), float(np.linalg.norm(fine - exact[:1, :1])) / size


def computed(chosen: Plan, weights: Array) -> Array:
    """The plan's transfers of masks, by whatever method."""
    rows, columns = chosen.model.scene.shape
    points = torch.eye(rows * columns, dtype=chosen.operator.dtype).reshape(-1, rows, columns)
    found = []
    with torch.no_grad():
        for mask in torch.from_numpy(weights):
            response = chosen.operator.response(mask)
            found.append(chosen.operator.collect(points, response).flatten(1).double().numpy())
    return np.stack(found)


def judge(seed: int) -> Result:
    """One job: its plan, and the truth."""
    job = draw(seed)
    start = time.process_time()
    try:
        chosen = plan(job.camera, job.scene, job.embedding, job.tolerance, job.conditions)
        planned = time.process_time() - start
        weights = masks(job)
        values = computed(chosen, weights)
    except OpticsError as error:
        return Result(
            seed, job.tolerance, 0, 0, False, 0, "", job.effects, 0, 0, refused=str(error)
        )
    start = time.process_time()
    exact, unsure = truth(job, weights)
    size = float(np.linalg.norm(exact))
    off = float(np.linalg.norm(values - exact)) / size if size else float(bool(values.any()))
    return Result(
        seed=seed,
        tolerance=job.tolerance,
        predicted=chosen.error,
        true=off,
        reached=chosen.reached,
        oracle_error=unsure,
        method=chosen.model.sampling.method if chosen.model.sampling.diffraction else "shadow",
        effects=job.effects,
        plan_seconds=round(planned, 3),
        oracle_seconds=round(time.process_time() - start, 3),
    )


def figures_of(results: Iterable[Result]) -> dict[str, float]:
    """The record's figures."""
    every = list(results)
    judged = [result for result in every if result.judged]
    reached = [result.reached_ratio for result in judged if result.reached]
    sharp = [result.predicted / max(result.true, 1e-12) for result in judged]
    return {
        "oracle_jobs": len(every),
        "oracle_honest_fraction": round(sum(r.honest for r in judged) / len(judged), 4),
        "oracle_worst_reached_ratio": round(max(reached, default=math.nan), 3),
        "oracle_sharpness_median": round(statistics.median(sharp), 3),
        "oracle_unjudged_fraction": round(1 - len(judged) / len(every), 4),
    }


def main(
    *,
    jobs: Annotated[int, typer.Option(min=1, help="How many, in the order of their seeds.")] = 1000,
    first: Annotated[int, typer.Option(help="The first seed.")] = 0,
    out: Annotated[Path, typer.Option(help="One JSON line a job; those there are kept.")] = Path(
        "build/oracle.jsonl"
    ),
    figures: Annotated[Path | None, typer.Option(help="Record to write into.")] = None,
) -> None:
    """Judge plans by exact light."""
    torch.set_num_threads(1)
    if figures is not None:
        check_record(figures)
    out.parent.mkdir(parents=True, exist_ok=True)
    lines = out.read_text().splitlines() if out.exists() else []
    done = {int(found["seed"]): Result(**found) for found in map(json.loads, lines)}
    seeds = range(first, first + jobs)
    with out.open("a") as file:
        for seed in seeds:
            if seed not in done:
                done[seed] = judge(seed)
                file.write(json.dumps(asdict(done[seed])) + "\n")
                file.flush()
    found = figures_of(done[seed] for seed in seeds)
    for name, value in found.items():
        typer.echo(f"{name:28} {value}")
    if figures is not None:
        record_figures(figures, found)


if __name__ == "__main__":
    typer.run(main)
