"""Checks of one mask: the field against others, the estimate against the whole error."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from benchmarks.accuracy.reference import reference_transfer
from tests.unit.optics.tensors import axial, mask, relative
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import IDEAL, Conditions, Imperfections
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.errors import OpticsError
from veilcam_optics.plan import plan
from veilcam_optics.simulation import check as checking
from veilcam_optics.simulation.check import CONFIDENCE, FullField, chances_of, estimate
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.tables import Reach

SCENE, EMBEDDING = Scene(3, 2, height=0.05), Embedding(4, 5)
AXIAL = Sampling(oblique=False)
WINDOWED = Camera(window=Window(6, 4), sensor=Sensor(rows=300, columns=400))
CAMERAS = {
    "filters": WINDOWED,
    "bare": replace(WINDOWED, panel=Panel(filter_cycle=())),
    "leaky": replace(WINDOWED, panel=Panel(filter_leakage=0.2)),
    "far": replace(WINDOWED, distance=30e-3),
    "near": replace(WINDOWED, distance=0.4e-3),
    "fine": Camera(
        panel=Panel(32, 32, 8e-6, 8e-6, 7e-6, 7e-6, filter_cycle=()),
        window=Window(8, 8, 0, 0),
        sensor=Sensor(60, 80),
        distance=1e-3,
    ),
}
CONDITIONS = {
    "field angle": IDEAL,
    "spectrum": Conditions(bandwidth=(250e-9, 200e-9, 0.0)),
    "depth": Conditions(depth_range=0.3),
    "panel": Conditions(levels=6, imperfections=Imperfections(gamma=1.8, contrast_floor=0.1)),
    "shift": Conditions(imperfections=Imperfections(shift_y=80e-6, shift_x=-50e-6)),
    "distance": Conditions(imperfections=Imperfections(distance_error=300e-6)),
    "bayer": Conditions(bayer=True),
}


@cache
def whole(model: Model) -> Tensor:
    """Every entry, by the check's own field; several tests compare with the same."""
    field = FullField(model, mask(model.camera, 5))
    pixels = model.scene.rows * model.scene.columns
    return torch.tensor(
        [[field.entry(p, e) for e in range(model.embedding.size)] for p in range(pixels)],
        dtype=torch.float64,
    )


@pytest.mark.thorough
@pytest.mark.parametrize(
    "name", ["filters", *(pytest.param(name, marks=pytest.mark.slow) for name in list(CAMERAS)[1:])]
)
def test_field_of_a_check_is_that_of_the_reference(name: str) -> None:
    """The reference's cells are converged to some millionths: finer where fringes are."""
    camera, oversampling = CAMERAS[name], {"near": 96, "fine": 48}.get(name, 16)
    truth = reference_transfer(camera, SCENE, EMBEDDING, mask(camera, 5), oversampling=oversampling)
    assert relative(whole(Model(camera, SCENE, EMBEDDING, sampling=AXIAL)), truth) < 3e-5


@pytest.mark.thorough
@pytest.mark.parametrize("name", CONDITIONS)
def test_field_of_a_check_counts_every_effect(name: str) -> None:
    """Against an operator with all pairs, each scene pixel's own angle, and as many samples."""
    conditions, camera = CONDITIONS[name], CAMERAS["filters"]
    scene = Scene(3, 2, height=0.4) if name == "field angle" else SCENE
    sampling = Sampling(
        reach=Reach(5, 3), wavelengths=7, layers=7, zones=3, step=0.1e-6, dtype=torch.float64
    )
    model = Model(camera, scene, EMBEDDING, conditions, sampling)
    with torch.no_grad():
        operated = LightOperator(model)(mask(camera, 5))
    found = whole(replace(model, sampling=Sampling()))
    assert relative(found, operated) < 1e-5
    ignored = AXIAL if name == "field angle" else Sampling()
    without = whole(Model(camera, scene, EMBEDDING, sampling=ignored))
    assert relative(without, operated) > 1e-4, "the effect is large enough to be tested"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "tolerance"), [("filters", 0.2), *((name, 1e-2) for name in CAMERAS)]
)
def test_whole_error_is_within_the_interval(name: str, tolerance: float) -> None:
    """One interval of twenty may miss: what has to hold for all is three times as wide."""
    camera = CAMERAS[name]
    chosen = plan(camera, SCENE, EMBEDDING, tolerance)
    true = relative(chosen.transfer(mask(camera, 5)), whole(chosen.asked))
    found = chosen.check(mask(camera, 5), entries=40)
    assert found.entries == 40
    assert found.low < found.error < found.high
    reach = 3 * math.log(found.high / found.error)
    assert abs(math.log(true / found.error)) < reach
    assert reach < 3 * math.log(2.5), "an interval that says something"


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["filters", "near", "far"])
def test_intervals_hold_the_truth_as_often_as_they_say(name: str) -> None:
    """Of 400 draws, CONFIDENCE; chance takes three of a hundred away, two standard deviations."""
    camera = CAMERAS[name]
    scene, embedding = Scene(4, 4, height=0.06), Embedding(9, 11)
    truth = reference_transfer(camera, scene, embedding, mask(camera, 5), oversampling=16).numpy()
    chosen = plan(camera, scene, embedding, 5e-2)
    computed = axial(chosen)(mask(camera, 5)).double().detach().numpy()
    true = float(np.linalg.norm(computed - truth) / np.linalg.norm(truth))
    chances = chances_of(computed)
    held, logs = 0, []
    for seed in range(400):
        generator = np.random.default_rng(seed)
        points = generator.integers(len(truth), size=48)
        pixels = np.array([generator.choice(embedding.size, p=chances[p]) for p in points])
        exact = truth[points, pixels]
        found = estimate(computed[points, pixels] - exact, exact, chances[points, pixels])
        held += found.low <= true <= found.high
        logs.append(math.log(found.error / true))
    assert held / 400 >= CONFIDENCE - 0.03
    assert abs(float(np.mean(logs))) < 0.15, "hardly biased"


def test_light_that_a_plan_misses_is_found() -> None:
    """Half of the draws are even: what a plan takes for dark is drawn too."""
    rows = np.array([[1.0, 0.0, 0.0, 0.0]])
    chances = chances_of(rows)
    assert np.min(chances) >= 1 / 8
    assert chances.sum() == pytest.approx(1)
    assert chances_of(np.zeros((1, 4))) == pytest.approx(1 / 4)


def test_dark_transfers_have_no_relative_error() -> None:
    nothing, even = np.zeros(8), np.full(8, 0.1)
    assert estimate(nothing, nothing, even).error == 0
    assert estimate(even, nothing, even).error == 1
    assert estimate(nothing, even, even).high == 0


def test_stray_light_is_spread_by_the_plans_own_mean() -> None:
    conditions = Conditions(imperfections=Imperfections(stray_light=0.3))
    camera = CAMERAS["filters"]
    chosen = plan(camera, SCENE, EMBEDDING, 1e-2, conditions)
    found = chosen.check(mask(camera, 5), entries=8)
    assert found.error < 1e-2
    ignored = LightOperator(replace(chosen.model, conditions=IDEAL))
    assert replace(chosen, model=ignored.model).check(mask(camera, 5), entries=8).error > 3e-2


def test_draws_repeat_and_seeds_differ() -> None:
    camera = CAMERAS["filters"]
    chosen = plan(camera, SCENE, EMBEDDING, 5e-2)
    one, again, other = (chosen.check(mask(camera, 5), entries=8, seed=seed) for seed in (1, 1, 2))
    assert one == again != other
    assert "8 entries" in str(one)


def test_checks_that_cannot_be_are_refused() -> None:
    camera = CAMERAS["filters"]
    chosen = plan(camera, SCENE, EMBEDDING, 5e-2)
    with pytest.raises(OpticsError, match="entries"):
        chosen.check(mask(camera, 5), entries=7)
    with pytest.raises(OpticsError, match=r"weights\.shape"):
        chosen.check(torch.rand(3, 3))
    turned = Conditions(imperfections=Imperfections(rotation=1e-3))
    with pytest.raises(OpticsError, match="rotation"):
        replace(chosen, asked=replace(chosen.asked, conditions=turned)).check(mask(camera, 5))
    near = replace(chosen.asked, camera=replace(camera, distance=1e-7))
    with pytest.raises(OpticsError, match="field values"):
        replace(chosen, asked=near).check(mask(camera, 5))


@pytest.mark.slow
def test_check_takes_fewer_entries_where_each_is_dear(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checking, "_WORK", checking._WORK / 6)
    camera = replace(CAMERAS["near"], distance=40e-6)
    chosen = plan(camera, SCENE, EMBEDDING, 5e-2)
    assert 8 <= chosen.check(mask(camera, 5), entries=400).entries < 400
