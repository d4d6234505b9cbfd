"""Plans of everyday cameras against exact light, in which no angle is taken for small.

- ``exact_honest_fraction``: share of 100 small cameras whose true error is at most twice the
  predicted one; the oracle's everyday jobs;
- ``default_scene_exact_error``: true error of the default camera's plan at a tolerance of 1e-2,
  over scene pixels drawn from the whole scene. Cells are 1 um along y and 3 um along x. An aperture
  is 60/73 of its pitch in either direction, along y 0.006 % less than it is.

    python -m benchmarks.optics.exact --figures benchmarks/results/optics.json

Each scene pixel takes a minute of one core and 6 GB.
"""

from __future__ import annotations

import random
from typing import Annotated

import numpy as np
import torch
import typer
from benchmarks.figures import FiguresOption, record
from tests.oracle.jobs import Job, draw_everyday, light, masks, shown
from tests.oracle.judge import computed, judge_job
from tests.oracle.physics import transfer

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import Conditions
from veilcam_optics.plan import plan

TOLERANCE = 1e-2
_FILL = (73, 60)
_COARSEST = 1e-3
"""One cell to each of the 73 parts of a pitch."""


def exact_honest_fraction(jobs: int) -> float:
    """Share of the plans that can be judged."""
    results = [judge_job(draw_everyday(seed), seed=seed) for seed in range(jobs)]
    judged = [result for result in results if not result.unjudged]
    print(f"judged {len(judged)} of {jobs}")
    return sum(result.honest for result in judged) / len(judged)


def default_scene_exact_error(pixels: int) -> float:
    """Relative L2 over so many scene pixels."""
    job = Job(Camera(), Scene(), Embedding(), Conditions(), TOLERANCE, (_FILL, _FILL))
    weights = masks(job, 1)
    chosen = plan(job.camera, job.scene, job.embedding, job.tolerance)
    values = computed(chosen, weights)[0]
    rows, columns = job.scene.shape
    drawn = random.Random(0).sample(range(rows * columns), pixels)
    wrong = there = 0.0
    for pixel in drawn:
        at = divmod(pixel, columns)
        exact = transfer(light(job), shown(job, weights), finer=_COARSEST, only=at)[0, 0]
        off, size = float(np.square(values[pixel] - exact).sum()), float(np.square(exact).sum())
        print(f"scene pixel {at}: {(off / size) ** 0.5:.3g}, predicted {chosen.error:.3g}")
        wrong, there = wrong + off, there + size
    return float((wrong / there) ** 0.5)


def main(
    *,
    jobs: Annotated[int, typer.Option(min=1, help="Small cameras.")] = 100,
    pixels: Annotated[int, typer.Option(min=1, help="Scene pixels of the default scene.")] = 12,
    figures: FiguresOption = None,
) -> None:
    """Print both figures; record them."""
    torch.set_num_threads(1)
    values = {
        "default_scene_exact_error": float(f"{default_scene_exact_error(pixels):.3g}"),
        "exact_honest_fraction": round(exact_honest_fraction(jobs), 4),
    }
    for name, value in values.items():
        print(f"{name:26s} {value:10.3g}")
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
