"""Light of the simulated camera against better light, and what it costs.

- ``simulated_light_error_over_tolerance``: error at the embedding over the predicted one, or over
  the tolerance where that is larger. It is the worst of the camera that the shipped bundles are
  for, against its operator with far reach and fine steps and zones, and of small everyday cameras,
  every other one built badly, against the oracle's exact light. The next is drawn where the oracle
  is not sure. No mask is turned: how far off plans are then is predicted within a factor alone
  (docs/effects.md);
- ``simulated_start_cpu_s``: CPU of ``veilcamd serve --simulate`` until it listens, at best;
- ``simulated_capture_ms``, ``simulated_fresh_mask_ms``: CPU of the light of one capture, and of a
  mask that was not shown before, on all raw pixels of the shipped bundles, at best.

    python -m benchmarks.daemon.light --figures benchmarks/results/optics.json
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import count, islice
from pathlib import Path
from typing import Annotated

import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.rig import prompt_daemon, work_folder
from structlog.testing import capture_logs
from tests.oracle.jobs import Job, draw_everyday, masks
from tests.oracle.judge import UNSURE, distance, truth
from tests.oracle.physics import Array

from veilcam_optics.camera.imperfections import Conditions, Imperfections
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.propagation.sampling import area_average
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.tables import Reach
from veilcam_server.demo_data import BUNDLE
from veilcam_server.devices.simulated.light import (
    TOLERANCE,
    Light,
    planned_light,
    use_torch_sparingly,
)
from veilcam_training.bundle import read_bundle

BUILT_BADLY = Imperfections(shift_y=30e-6, shift_x=-20e-6, distance_error=20e-6, gamma=1.3)
FINEST = Sampling(reach=Reach(12, 4), zones=7, step=3e-7, dtype=torch.float64)
_SCENES = 64
"""Scene pixels whose light on raw pixels is held at once."""


def simulated(job: Job) -> tuple[Light, float]:
    """Return the light of a job's camera, and how far off it says that it may be."""
    with capture_logs() as logs:
        made = planned_light(job.camera, job.scene, job.embedding, job.conditions.imperfections)
    return made, max(TOLERANCE, *(entry["predicted_error"] for entry in logs))


def at_embedding(made: Light, job: Job, weights: Array) -> Array:
    """Return the light of every scene pixel, (scene pixels, embedding pixels)."""
    points = torch.eye(math.prod(job.scene.shape)).reshape(-1, *job.scene.shape)
    with torch.no_grad():
        response = made.response(torch.from_numpy(weights))
        some = [made.collect(scenes, response) for scenes in torch.split(points, _SCENES)]
        binned = [area_average(raw.double(), *job.embedding.shape).flatten(1) for raw in some]
    return torch.cat(binned).numpy()


def shipped() -> Job:
    """Return the camera of the bundles that come along, as a job of the oracle."""
    bundle = read_bundle(BUNDLE)
    where = (bundle.camera, bundle.scene, bundle.embedding)
    return Job(*where, Conditions(), TOLERANCE, ((73, 60), (73, 60)))


def shipped_ratio(job: Job) -> float:
    """Error over the allowed one, of a camera that is too large for the oracle."""
    made, allowed = simulated(job)
    weights = masks(job, 1)[0]
    finest = Model(job.camera, job.scene, job.embedding, job.conditions, FINEST)
    with torch.no_grad():
        better = LightOperator(finest)(torch.from_numpy(weights)).numpy()
    error = distance(at_embedding(made, job, weights), better)
    print(f"shipped: error {error:.2e}, allowed {allowed:.2e}", flush=True)
    return error / allowed


def drawn_ratio(seed: int) -> float | None:
    """Error over the allowed one, of a small everyday camera; None where the oracle is not sure."""
    job = draw_everyday(seed)
    if seed % 2:
        job = replace(job, conditions=Conditions(imperfections=BUILT_BADLY))
    made, allowed = simulated(job)
    weights = masks(job, 1)
    exact, unsure = truth(job, weights, lambda _: UNSURE * allowed)
    error = distance(at_embedding(made, job, weights[0])[None], exact)
    if unsure > UNSURE * max(error, allowed):
        return None
    print(f"seed {seed}: error {error:.2e}, allowed {allowed:.2e}", flush=True)
    return error / allowed


def cpu(action: Callable[[], object], times: int = 20) -> float:
    """CPU of an action, the least of many times [s]."""
    taken = []
    for _ in range(times):
        begun = time.process_time()
        action()
        taken.append(time.process_time() - begun)
    return min(taken)


def start_cpu() -> float:
    """CPU of a simulated daemon that listens now [s]."""
    with work_folder() as folder, prompt_daemon(folder):
        child = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()[-1]
        spent = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[11:13]
    return sum(map(int, spent)) / os.sysconf("SC_CLK_TCK")


def main(
    *,
    quick: Annotated[bool, typer.Option(help="One small camera, one start.")] = False,
    cameras: Annotated[int, typer.Option(min=1, help="Small ones.")] = 10,
    starts: Annotated[int, typer.Option(min=1)] = 5,
    figures: FiguresOption = None,
) -> None:
    """Compare the light with better light, and measure what it costs."""
    use_torch_sparingly()
    sure = (ratio for ratio in map(drawn_ratio, count()) if ratio is not None)
    ratios = list(islice(sure, 1 if quick else cameras))
    job = shipped()
    if not quick:
        ratios.append(shipped_ratio(job))
    made, _ = simulated(job)
    weights, scene = torch.from_numpy(masks(job, 1)[0]), torch.rand(1, *job.scene.shape)
    with torch.no_grad():
        response = made.response(weights)
        values = {
            "simulated_light_error_over_tolerance": max(ratios),
            "simulated_capture_ms": 1e3 * cpu(lambda: made.collect(scene, response)),
            "simulated_fresh_mask_ms": 1e3 * cpu(lambda: made.response(weights)),
            "simulated_start_cpu_s": min(start_cpu() for _ in range(1 if quick else starts)),
        }
    for name, value in values.items():
        print(f"{name}: {value:.3g}")
    record(figures, {name: float(f"{value:.3g}") for name, value in values.items()})


if __name__ == "__main__":
    typer.run(main)
