"""Plans of everyday cameras against exact light, in which no angle is taken for small.

- ``exact_honest_fraction``: share of 100 small cameras whose true error is at most twice the
  predicted one; the oracle's everyday jobs;
- ``default_scene_exact_error``: true error of the default camera's plan at a tolerance of 1e-2,
  estimated over the whole scene from strips drawn at random: all rows of two neighbouring columns
  of the embedding, of one scene pixel. ``default_scene_exact_error_half_interval`` is half of the
  interval that holds it in nine of ten draws.

Cells are 1 um along y and 3 um along x. An aperture is 60/73 of its pitch in either direction,
along y 0.006 % less than it is. Along y light comes from the whole mask; along x what moves farther
than 0.6 mm is left out: of an aperture ``a`` wide, the share ``lambda / (pi^2 a t)`` goes out at
more than the tangent ``t`` = 0.15, which is 0.2 %.

    python -m benchmarks.optics.exact --figures benchmarks/results/optics.json

A strip takes some 6 s of one core and 1 GB.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import torch
import typer
from benchmarks.figures import FiguresOption, record
from scipy import stats
from tests.oracle.jobs import Job, draw_everyday, light, masks, shown
from tests.oracle.judge import computed, judge_job
from tests.oracle.physics import Array, Light, transfer

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import Conditions
from veilcam_optics.plan import plan

TOLERANCE = 1e-2
COLUMNS = 2
"""Of the embedding, in a strip."""

REACH = 0.6e-3
"""How far light is followed along x [m]."""

_FILL = (73, 60)
_COARSEST = 1e-3
"""One cell to each of the 73 parts of a pitch."""


def exact_honest_fraction(jobs: int) -> float:
    """Share of the plans that can be judged."""
    results = [judge_job(draw_everyday(seed), seed=seed) for seed in range(jobs)]
    judged = [result for result in results if not result.unjudged]
    print(f"judged {len(judged)} of {jobs}")
    for result in judged:
        if not result.honest:
            print(f"seed {result.seed}: {result.true:.3g}, predicted {result.predicted:.3g}")
    return sum(result.honest for result in judged) / len(judged)


@dataclass(frozen=True)
class Strip:
    """Some columns of one scene pixel's transfer: what was drawn, and both ways to compute it."""

    pixel: tuple[int, int]
    column: int
    exact: Array
    computed: Array

    @property
    def wrong(self) -> float:
        """Square of the difference."""
        return float(np.square(self.computed - self.exact).sum())

    @property
    def there(self) -> float:
        """Square of the exact values."""
        return float(np.square(self.exact).sum())


def default_scene_exact_error(strips: int) -> tuple[float, float]:
    """Relative L2 over the whole scene, estimated from so many strips, and half its interval."""
    job = Job(Camera(), Scene(), Embedding(), Conditions(), TOLERANCE, (_FILL, _FILL))
    weights = masks(job, 1)
    chosen = plan(job.camera, job.scene, job.embedding, job.tolerance)
    values = computed(chosen, weights)[0].reshape(*job.scene.shape, *job.embedding.shape)
    optics, amplitudes, generator, found = light(job), shown(job, weights), random.Random(0), []
    for _ in range(strips):
        pixel = generator.randrange(job.scene.rows), generator.randrange(job.scene.columns)
        column = generator.randrange(job.embedding.columns // COLUMNS) * COLUMNS
        seen = slice(column, column + COLUMNS)
        exact = strip_transfer(optics, amplitudes, pixel, seen)
        found.append(Strip(pixel, column, exact, values[(*pixel, slice(None), seen)]))
        here = found[-1]
        error = math.sqrt(here.wrong / here.there)
        print(f"scene pixel {pixel}, column {column}: {error:.3g}, predicted {chosen.error:.3g}")
    return ratio_estimate([strip.wrong for strip in found], [strip.there for strip in found])


def strip_transfer(
    optics: Light,
    amplitudes: Array,
    pixel: tuple[int, int],
    seen: slice,
    *,
    reach: float = REACH,
    finer: float = _COARSEST,
) -> Array:
    """Exact transfer of one scene pixel to some columns of the embedding, (rows, columns).

    Light moves no farther along x than ``reach`` [m]; along y as far as it will. The middle of the
    columns is the origin, and mask and scene are moved.

    Args:
        optics: all of the light, of a mask in the middle of the sensor.
        amplitudes: what each channel's light passes, (1, 3, rows, columns).
        pixel: of the scene.
        seen: columns of the embedding.
        reach: how far light is followed along x [m].
        finer: factor on the number of cells.
    """
    x = optics.x
    width = x.sensor / x.pixels
    middle = ((seen.start + seen.stop) / 2 - x.pixels / 2) * width
    scene = [
        (at - (axis.scene_pixels - 1) / 2) * axis.scene_pixel
        for at, axis in zip(pixel, (optics.y, optics.x), strict=True)
    ]
    length = (seen.stop - seen.start) * width
    # What falls on the columns comes straight from a scene point through the mask.
    distance = optics.beams[0].scene_distance
    through = (middle * distance + scene[1] * optics.distance) / (distance + optics.distance)
    far = length / 2 + reach
    first, last = (
        min(x.apertures, max(0, round((through + end * far) / x.pitch + x.apertures / 2)))
        for end in (-1, 1)
    )
    first = min(first, x.apertures - 1)
    last = max(last, first + 1)
    window = replace(
        optics,
        y=replace(optics.y, scene_pixels=1, scene_shift=scene[0]),
        x=replace(
            x,
            apertures=last - first,
            sensor=length,
            pixels=seen.stop - seen.start,
            scene_pixels=1,
            shift=((first + last) / 2 - x.apertures / 2) * x.pitch - middle,
            scene_shift=scene[1] - middle,
        ),
    )
    found: Array = transfer(window, amplitudes[..., first:last], finer=finer)[0, 0]
    share = 1 / (optics.y.scene_pixels * x.scene_pixels)
    return share * found.reshape(optics.y.pixels, seen.stop - seen.start)


def ratio_estimate(wrong: Sequence[float], there: Sequence[float]) -> tuple[float, float]:
    """``sqrt(sum(wrong) / sum(there))`` of a sample, and half of its interval of nine in ten.

    By the residuals of the ratio (Cochran, Sampling Techniques, 3rd ed., equation 6.13) and
    Student's t.
    """
    above, below = np.asarray(wrong), np.asarray(there)
    ratio, count = float(above.sum()) / float(below.sum()), len(above)
    residuals = above - ratio * below
    deviation = math.sqrt(np.square(residuals).sum() / (count - 1) / count) / below.mean()
    error = math.sqrt(ratio)
    return error, float(stats.t.ppf(0.95, count - 1)) * deviation / (2 * error)


def main(
    *,
    jobs: Annotated[int, typer.Option(min=0, help="Small cameras; 0 for none.")] = 100,
    strips: Annotated[int, typer.Option(min=0, help="Of the default scene; 0 for none.")] = 16,
    figures: FiguresOption = None,
) -> None:
    """Print all figures; record them."""
    torch.set_num_threads(1)
    values = {}
    if strips:
        error, half = default_scene_exact_error(strips)
        values["default_scene_exact_error"] = float(f"{error:.3g}")
        values["default_scene_exact_error_half_interval"] = float(f"{half:.2g}")
    if jobs:
        values["exact_honest_fraction"] = round(exact_honest_fraction(jobs), 4)
    for name, value in values.items():
        print(f"{name:40s} {value:10.3g}")
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
