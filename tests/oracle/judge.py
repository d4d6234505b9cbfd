"""One plan against exact light: the error it predicts, the true one, and what was possible."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from types import FrameType

import numpy as np
import torch

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import Conditions
from veilcam_optics.errors import OpticsError
from veilcam_optics.plan import Plan, plan
from veilcam_optics.plan.cost import cost
from veilcam_optics.transfer.operator import Reach

from .jobs import MOST_WORK, Job, draw, light, masks, read, scattered, shown
from .physics import Array, transfer

UNSURE = 0.3
"""An oracle that is itself this share of the larger of both errors off cannot judge them."""

LIMIT = 8.0
"""Seconds of the processor that a job may take."""

_FINER_WORK = 3 * MOST_WORK
"""To which an oracle that is unsure of a job goes on: that still ends before the limit."""

_POINT = 3e-3
"""Angle up to which a scene pixel is a point without a doubt [rad]: 1e-5 of its light."""

_MOST_NODES = 3000
"""Integration nodes along a side of the finest setting."""

Planner = Callable[[Camera, Scene, Embedding, float, Conditions], Plan]


@dataclass(frozen=True)
class Result:
    """What came of one job."""

    seed: int
    tolerance: float
    effects: tuple[str, ...]
    unaffordable: int = 0
    predicted: float = 0.0
    true: float = 0.0
    reached: bool = False
    oracle_error: float = 0.0
    """Of one scene pixel, against cells half as wide and more points in it: relative L2."""
    finest: float = math.nan
    """True error with all interference, where the plan reaches nothing."""
    time_over_best: float = 1.0
    """Predicted time over that of the fastest setting of less reach whose true error will do."""
    method: str = ""
    plan_seconds: float = 0.0
    oracle_seconds: float = 0.0
    refused: str = ""
    late: str = ""

    @property
    def unjudged(self) -> str:
        """Why there is no verdict; empty if there is one."""
        if self.refused or self.late:
            return "refused" if self.refused else f"late: {self.late}"
        sure = self.oracle_error <= UNSURE * max(self.predicted, self.true)
        return "" if sure else "the oracle is not sure"

    @property
    def honest(self) -> bool:
        """Whether the true error is at most twice the predicted one."""
        return self.true <= 2 * self.predicted

    @property
    def reached_ratio(self) -> float:
        """True error over what a plan that says "reached" promises."""
        return self.true / max(self.predicted, self.tolerance / 10)

    @property
    def reachable(self) -> bool:
        """Whether full reach gets within the tolerance, or the plan itself does."""
        return self.true <= self.tolerance or self.finest <= self.tolerance


def truth(job: Job, weights: Array, enough: Callable[[Array], float]) -> tuple[Array, float]:
    """Exact transfers of masks, and how far they are from those of cells half as wide.

    Args:
        job: whose.
        weights: masks.
        enough: error that will do, of the transfers; below it cells and points are made no finer.
    """
    optics, amplitudes = light(job), shown(job, weights)
    angle = optics.y.scene_pixel / job.scene.distance
    finer = optics.affordable(MOST_WORK) or 1.0
    while True:
        exact = transfer(optics, amplitudes, finer=finer)
        more = replace(optics, sources=optics.sources + (angle > _POINT))
        fine = transfer(more, amplitudes[:1], finer=2 * finer, only=(0, 0))
        size = float(np.linalg.norm(fine)) or 1.0
        unsure = float(np.linalg.norm(fine - exact[:1, :1])) / size
        exact = scattered(job, exact)
        optics = replace(optics, sources=optics.sources + 2 * (angle > _POINT))
        finer *= 2
        if unsure <= enough(exact) or optics.work(finer) > _FINER_WORK:
            return exact, unsure


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


def measured(chosen: Plan, weights: Array) -> Array:
    """What the plan's camera reads of a white scene behind each mask."""
    white = torch.ones(1, *chosen.model.scene.shape, dtype=chosen.operator.dtype)
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        values = [chosen.embed(white, mask, generator) for mask in torch.from_numpy(weights)]
    return torch.stack(values).flatten(1).double().numpy()


def distance(values: Array, exact: Array, size: Array | None = None) -> float:
    """Relative L2, against the norm of ``size`` or of ``exact``."""
    norm = float(np.linalg.norm(exact if size is None else size))
    return float(np.linalg.norm(values - exact)) / norm


def finest(chosen: Plan) -> Plan:
    """The plan's model with all interference, many samples and in float64."""
    model = chosen.model
    camera, embedding = model.camera, model.embedding
    rows, columns = camera.mask_shape
    height, width = camera.lit_sides(model.scene)
    mask = max(rows * camera.panel.pitch_y, columns * camera.panel.pitch_x)
    fringe = min(camera.wavelengths) * camera.distance / mask
    pixel = min(camera.sensor.height / embedding.rows, camera.sensor.width / embedding.columns)
    used = model.with_sampling(
        reach=Reach(rows - 1, columns - 1),
        step=max(min(fringe / 4, pixel / 16), max(height, width) / _MOST_NODES),
        wavelengths=5 if any(model.conditions.bandwidth) else 1,
        layers=5 if model.conditions.depth_range else 1,
        zones=max(model.scene.shape) if model.conditions.off_axis else 1,
        dtype=torch.float64,
    )
    sampling = replace(used.sampling, method="transfer", diffraction=True, spherical=True)
    return replace(chosen, model=replace(used, sampling=sampling))


def time_over_best(chosen: Plan, weights: Array, exact: Array) -> float:
    """Predicted time over that of the fastest plan of less reach that is accurate enough."""
    reach = chosen.model.sampling.reach
    fewer = {
        Reach(rows, columns)
        for rows in {0, reach.rows // 2, max(0, reach.rows - 1), reach.rows}
        for columns in {0, max(0, reach.columns - 1), reach.columns}
    } - {reach}
    best = chosen.cost.step_ms
    for less in fewer:
        model = chosen.model.with_sampling(reach=less)
        time_ms = cost(model, chosen.batch).step_ms
        if time_ms >= best:
            continue
        if distance(computed(replace(chosen, model=model), weights), exact) <= chosen.tolerance:
            best = time_ms
    return chosen.cost.step_ms / best


def judge_job(job: Job, *, seed: int = 0, planner: Planner = plan) -> Result:
    """One job: its plan, and the truth."""
    result = Result(seed, job.tolerance, job.effects, job.unaffordable)
    phase, start = "plan", time.process_time()
    try:
        with _limit(LIMIT):
            chosen = planner(job.camera, job.scene, job.embedding, job.tolerance, job.conditions)
            result = replace(result, plan_seconds=round(time.process_time() - start, 3))
            weights = masks(job)
            values = computed(chosen, weights)
            phase, start = "oracle", time.process_time()
            exact, unsure = truth(
                job,
                weights,
                lambda exact: UNSURE * max(chosen.error, distance(values, exact)),
            )
            result = replace(result, oracle_seconds=round(time.process_time() - start, 3))
            true = distance(values, exact)
            if job.measured:
                dark = exact.sum(1)
                there = read(job, dark)
                true = max(true, distance(measured(chosen, weights), there, dark))
            phase = "settings"
            if not chosen.reached:
                best = distance(computed(finest(chosen), weights), exact)
                result = replace(result, finest=best)
            elif chosen.model.sampling.method == "transfer" and not job.measured:
                result = replace(result, time_over_best=time_over_best(chosen, weights, exact))
    except OpticsError as error:
        return replace(result, refused=str(error))
    except _LateError:
        return replace(result, late=phase)
    sampling = chosen.model.sampling
    return replace(
        result,
        predicted=chosen.error,
        true=true,
        reached=chosen.reached,
        oracle_error=unsure,
        method=sampling.method if sampling.diffraction else "shadow",
    )


def judge(seed: int) -> Result:
    """The job of one seed."""
    return judge_job(draw(seed), seed=seed)


class _LateError(Exception):
    """A job took too long."""


@contextmanager
def _limit(seconds: float) -> Iterator[None]:
    """Raise :class:`_LateError` after so many seconds of the processor, however busy it is."""

    def end(signum: int, frame: FrameType | None) -> None:
        raise _LateError

    before = signal.signal(signal.SIGPROF, end)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
