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
from veilcam_optics.transfer.tables import Reach

from .jobs import MOST_WORK, Job, draw, light, masks, read, scattered, shown
from .physics import Array, Light, extrapolated, transfer

UNSURE = 0.3
"""An oracle that is itself this share of the larger of both errors off cannot judge them."""

LIMIT = 8.0  # [s]

_SURE_WITHIN = 0.8
"""Share of the limit in which an oracle that is unsure of a job tries again."""

_PARTS = 3
"""Cells are taken in halves first, and in thirds where that is not enough: by quarters, both are
judged."""

_COARSER, _FINER, _SAFE = 0.6, 2.0, 1.2
"""Factors on the number of cells when it does: fewer where points in scene pixels are lacking,
and somewhat more than a series says."""

_POINT = 3e-3
"""Angle up to which a scene pixel is a point without a doubt [rad]: 1e-5 of its light."""

_MOST_NODES = 3000

Planner = Callable[[Camera, Scene, Embedding, float, Conditions], Plan]


@dataclass(frozen=True)
class Result:
    seed: int
    tolerance: float
    effects: tuple[str, ...]
    unaffordable: int = 0
    predicted: float = 0.0
    true: float = 0.0
    reached: bool = False
    oracle_error: float = 0.0
    """Of scene pixels in the corner and in the middle: what cells half as wide and smaller change,
    by how much more they change elsewhere, and what more points in them do; relative L2."""
    finest: float = math.nan
    time_over_best: float = 1.0
    """Predicted time over that of the fastest setting of less reach whose true error will do."""
    method: str = ""
    plan_seconds: float = 0.0
    oracle_seconds: float = 0.0
    refused: str = ""
    late: str = ""

    @property
    def unjudged(self) -> str:
        if self.refused or self.late:
            return "refused" if self.refused else f"late: {self.late}"
        sure = self.oracle_error <= UNSURE * max(self.predicted, self.true)
        return "" if sure else "the oracle is not sure"

    @property
    def honest(self) -> bool:
        return self.true <= 2 * self.predicted

    @property
    def reached_ratio(self) -> float:
        """True error over what a plan that says "reached" promises."""
        return self.true / max(self.predicted, self.tolerance / 10)

    @property
    def reachable(self) -> bool:
        return self.true <= self.tolerance or self.finest <= self.tolerance


def truth(
    job: Job, weights: Array, enough: Callable[[Array], float], *, limit: float = LIMIT
) -> tuple[Array, float]:
    optics, amplitudes = light(job), shown(job, weights)
    narrow = optics.y.scene_pixel / job.scene.distance <= _POINT
    finer = (optics.affordable(MOST_WORK) or 1.0) / 2
    end = time.process_time() + _SURE_WITHIN * limit
    while True:
        start, done = time.process_time(), _work_of_all(optics, finer)
        found = [transfer(optics, amplitudes, finer=finer)]
        began = time.process_time()
        found.append(transfer(optics, amplitudes, finer=finer, times=2))
        took = time.process_time() - began
        picked, fine = _by_finer_cells(optics, amplitudes[:1], found[1][:1], finer)
        while True:
            parts = len(found)
            # Where larger cells are too large for a series, the smaller alone are closer.
            ways = [found[-1], extrapolated(found[-2], found[-1], parts / (parts - 1))]
            coarse = [distance(way[:1, picked], fine) for way in ways]
            exact, cells = scattered(job, ways[int(np.argmin(coarse))]), min(coarse)
            cells *= _elsewhere(ways, picked)
            few = 0.0 if narrow else _by_more_points(optics, amplitudes[:1], found, finer)
            wanted = enough(exact)
            if cells + few <= wanted:
                return exact, cells + few
            now = time.process_time()
            if parts == _PARTS or cells < wanted / 2 or now + (parts + 1) ** 2 / 4 * took > end:
                break
            found.append(transfer(optics, amplitudes, finer=finer, times=parts + 1))
        better = _better(optics, finer, 2 * cells / wanted, 2 * few / wanted)
        allowed = (end - now) / (now - start) * done
        fitting = [one for one in better if _work_of_all(*one) <= allowed]
        if not fitting:
            return exact, cells + few
        optics, finer = fitting[0]


def _better(optics: Light, finer: float, cells: float, few: float) -> list[tuple[Light, float]]:
    """More points and finer cells, from as many as would do to hardly more."""
    factor = min(_FINER, max(_COARSER, _SAFE * cells**0.25))
    least = int(few > 1 / 2)
    more = max(least, math.ceil(optics.sources * (min(2.0, math.sqrt(few)) - 1)))
    return [
        (
            replace(optics, sources=optics.sources + max(least, round(part * more))),
            finer * (factor if factor < 1 else 1 + part * (factor - 1)),
        )
        for part in (1.0, 0.75, 0.5, 0.25)
    ]


def _by_finer_cells(
    optics: Light, amplitudes: Array, halves: Array, finer: float
) -> tuple[list[int], Array]:
    """Scene pixels in the corner and in the middle, and their transfers by half as wide cells."""
    columns = optics.x.scene_pixels
    pixels = sorted({(0, 0), (optics.y.scene_pixels // 2, columns // 2)})
    picked = [row * columns + column for row, column in pixels]
    quarters = [transfer(optics, amplitudes, finer=finer, times=4, only=pixel) for pixel in pixels]
    return picked, extrapolated(halves[:, picked], np.concatenate(quarters, axis=1), 2.0)


def _elsewhere(ways: list[Array], picked: list[int]) -> float:
    """How much more cells change all transfers of all masks than some of the first mask's."""
    one, other = ways
    here = distance(one[:1, picked], other[:1, picked])
    return distance(one, other) / here if here else 1.0


def _by_more_points(optics: Light, amplitudes: Array, found: list[Array], finer: float) -> float:
    """What more points in the scene pixel in the corner change: relative L2."""
    more = replace(optics, sources=optics.sources + 1)
    other = transfer(more, amplitudes, finer=finer, times=len(found), only=(0, 0))
    return distance(found[-1][:1, :1], other)


def _work_of_all(optics: Light, finer: float) -> float:
    pixels = optics.y.scene_pixels * optics.x.scene_pixels
    once, halves, fourths = (optics.work(finer, times) for times in (1, 2, 4))
    checked = min(2, pixels) * fourths + halves * (1 + 1 / optics.sources) ** 2
    return once + halves + checked / pixels / 2  # one mask takes half as long as three


def computed(chosen: Plan, weights: Array) -> Array:
    rows, columns = chosen.model.scene.shape
    points = torch.eye(rows * columns, dtype=chosen.operator.dtype).reshape(-1, rows, columns)
    found = []
    with torch.no_grad():
        for mask in torch.from_numpy(weights):
            response = chosen.operator.response(mask)
            found.append(chosen.operator.collect(points, response).flatten(1).double().numpy())
    return np.stack(found)


def measured(chosen: Plan, weights: Array) -> Array:
    white = torch.ones(1, *chosen.model.scene.shape, dtype=chosen.operator.dtype)
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        values = [chosen.embed(white, mask, generator) for mask in torch.from_numpy(weights)]
    return torch.stack(values).flatten(1).double().numpy()


def distance(values: Array, exact: Array, size: Array | None = None) -> float:
    norm = float(np.linalg.norm(exact if size is None else size))
    return float(np.linalg.norm(values - exact)) / (norm or 1.0)


def finest(chosen: Plan) -> Plan:
    model = chosen.model
    camera, embedding = model.camera, model.embedding
    rows, columns = camera.mask_shape
    height, width = camera.lit_sides(model.scene)
    mask = max(rows * camera.panel.pitch_y, columns * camera.panel.pitch_x)
    fringe = min(camera.wavelengths) * camera.distance / mask
    pixel = min(embedding.box(camera.sensor))
    used = model.with_sampling(
        reach=Reach(rows - 1, columns - 1),
        step=max(min(fringe / 4, pixel / 16), max(height, width) / _MOST_NODES),
        wavelengths=5 if any(model.conditions.bandwidth) else 1,
        layers=5 if model.conditions.depth_range else 1,
        zones=max(model.scene.shape) if model.sampling.oblique else 1,
        dtype=torch.float64,
    )
    sampling = replace(used.sampling, method="transfer", diffraction=True, spherical=True)
    return replace(chosen, model=replace(used, sampling=sampling))


def time_over_best(chosen: Plan, weights: Array, exact: Array) -> float:
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


def judge_job(job: Job, *, seed: int = 0, planner: Planner = plan, limit: float = LIMIT) -> Result:
    effects = (*job.effects, *(("fill",) if job.embedding.fill < 1 else ()))
    result = Result(seed, job.tolerance, effects, job.unaffordable)
    phase, start = "plan", time.process_time()
    try:
        with _limit(limit):
            chosen = planner(job.camera, job.scene, job.embedding, job.tolerance, job.conditions)
            result = replace(result, plan_seconds=round(time.process_time() - start, 3))
            weights = masks(job)
            values = computed(chosen, weights)
            phase, start = "oracle", time.process_time()
            exact, unsure = truth(
                job,
                weights,
                lambda exact: UNSURE * max(chosen.error, distance(values, exact)),
                limit=limit,
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
