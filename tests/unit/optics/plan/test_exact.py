"""Plans against exact light, and the bounds that they rest on against what they bound."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.oracle.jobs import Job, masks
from tests.oracle.judge import computed, distance, truth
from tests.unit.optics.tensors import bare, relative
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import Conditions, Imperfections
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.plan import plan
from veilcam_optics.plan.bounds import far_pairs
from veilcam_optics.plan.grids import OVERSAMPLINGS, GridErrors, grid_error
from veilcam_optics.plan.probe import Probe
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.tables import Reach


@pytest.mark.thorough
def test_fine_pitch_is_not_said_to_be_reached_where_it_is_not() -> None:
    """Fringes of 40 x 40 sub-pixels of 3 um, 2 mm away, are wider than a pixel."""
    camera = Camera(
        panel=bare(3e-6, 3e-6), window=Window(40, 40), sensor=Sensor(16, 16, 8e-6), distance=2e-3
    )
    scene, embedding = Scene(2, 2, height=0.005), Embedding(16, 16)
    chosen = plan(camera, scene, embedding, 1e-2)
    job = Job(camera, scene, embedding, Conditions(), 1e-2, ((1, 1), (1, 1)))
    weights = masks(job)
    exact, unsure = truth(job, weights, lambda _: 1e-4)
    found = distance(computed(chosen, weights), exact)
    assert unsure < found / 10
    assert found < 2 * chosen.error
    assert not chosen.reached or found < 3e-2


def test_effects_are_judged_with_the_interference_that_is_there() -> None:
    """In the mid-infrared every pair of 10 columns of 25 um makes fringes wider than a pixel."""
    camera = Camera(
        panel=bare(25e-6, 25e-6),
        window=Window(8, 10),
        sensor=Sensor(24, 24, 8e-6),
        distance=1.2e-3,
        wavelengths=(5e-6,) * 3,
    )
    scene, embedding = Scene(3, 3, height=0.02), Embedding(12, 12)
    chosen = plan(camera, scene, embedding, 1e-3)
    sampling = Sampling(reach=Reach(7, 9), dtype=torch.float64)
    whole = Model(camera, scene, embedding, sampling=sampling)
    points = replace(whole, sampling=replace(sampling, binning=False))
    weights = torch.rand(8, 10, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    measured = relative(LightOperator(points)(weights), LightOperator(whole)(weights))
    judged = {found.name: found for found in chosen.assessments}["pixel binning"]
    assert measured > 1e-3
    assert judged.matters
    assert measured / 2 < judged.error < 2 * measured


@settings(deadline=None, derandomize=True, max_examples=30)
@given(
    pitch=st.floats(math.log(2e-6), math.log(5e-4)).map(math.exp),
    fill=st.floats(0.2, 1.0),
    fresnel=st.floats(math.log(1e-2), math.log(30)).map(math.exp),
    wavelength=st.floats(3e-7, 1.2e-5),
    pixels=st.integers(1, 8),
    side=st.floats(0.3, 2.0),
    angle=st.floats(1e-4, 0.1),
)
def test_pairs_far_apart_add_no_more_than_their_bound(
    *,
    pitch: float,
    fill: float,
    fresnel: float,
    wavelength: float,
    pixels: int,
    side: float,
    angle: float,
) -> None:
    """One row of sub-pixels, every reach: what farther pairs add, and what was to be expected."""
    panel = bare(pitch, fill * pitch)
    camera = Camera(
        panel=panel,
        window=Window(9, 1),
        sensor=Sensor(16, 16, 9 * pitch * side / 16),
        distance=(fill * pitch) ** 2 / wavelength / fresnel,
        wavelengths=(wavelength,) * 3,
    )
    scene = Scene(2, 1, height=2e3 * angle, distance=1e3)
    model = Model(camera, scene, Embedding(pixels, 1))
    model = model.with_sampling(reach=Reach(8, 0))
    bounds = far_pairs(model, 0)
    found = Probe(model).within(model, range(9), [0])[:, 0]
    for reach in range(8):
        added = float((found[reach] - found[-1]).norm() / found[-1].norm())
        assert added <= 1.5 * float(bounds[reach + 1 :].sum())


@pytest.mark.parametrize("method", ["transfer", "grid"])
def test_only_the_grid_counts_large_angles(method: str) -> None:
    """It is on in a plan of the grid alone, and there its error is in no other's budget."""
    camera = Camera(
        panel=bare(3e-6, 3e-6), window=Window(4, 4), sensor=Sensor(8, 8, 3e-6), distance=60e-6
    )
    chosen = plan(camera, Scene(2, 2, height=0.02), Embedding(2, 2), 1e-3, method=method)  # type: ignore[arg-type]
    found = {each.name: each for each in chosen.assessments}["non-paraxial diffraction"]
    assert found.error > 1e-3
    assert found.matters == (method == "grid")
    assert method == "grid" or chosen.error >= found.error


def small(**changes: object) -> Camera:
    """3 x 2 apertures of 80 um, whose shadows fill the sensor 4 mm behind them."""
    camera = Camera(
        panel=bare(100e-6, 80e-6), window=Window(3, 2), sensor=Sensor(7, 9, 30e-6), distance=4e-3
    )
    return replace(camera, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "conditions",
    [
        Conditions(bayer=True),
        Conditions(imperfections=Imperfections(stray_light=0.3)),
    ],
    ids=["shares", "scattered"],
)
def test_probe_looks_at_what_is_judged(conditions: Conditions) -> None:
    """Its entries are those of the transfer matrix, whatever weighs them after the optics."""
    scene, embedding = Scene(2, 3, height=0.2), Embedding(3, 4)
    model = Model(small(), scene, embedding, conditions)
    model = model.with_sampling(reach=Reach(2, 1), step=1e-6, dtype=torch.float64)
    probe = Probe(model)
    assert len(probe.kept_y) == 6
    assert len(probe.kept_x) == 12
    found = probe.transfer(model)[0]
    matrix = LightOperator(model)(probe.masks[0]).reshape(2, 3, 3, 4)
    wanted = matrix.permute(0, 2, 1, 3).reshape(6, 12)
    assert relative(found[probe.kept_y.argsort()][:, probe.kept_x.argsort()], wanted) < 2e-3


@pytest.mark.parametrize("embedding", [Embedding(3, 4), Embedding(3, 7), Embedding(3, 20)])
def test_probe_of_fewer_offsets_takes_what_the_whole_has(embedding: Embedding) -> None:
    model = Model(small(), Scene(6, 5, height=0.02), embedding)
    model = model.with_sampling(reach=Reach(2, 1), step=1e-6)
    whole = Probe(model)
    every = whole.transfer(model)
    own, taken = (Probe(model, 6, one).transfer(model) for one in (Probe(model), whole))
    fewer = Probe(model, 6, whole)
    assert 6 <= len(fewer.kept_x) < len(whole.kept_x)
    rows, columns = (
        [some.tolist().index(one) for one in kept.tolist()]
        for kept, some in ((fewer.kept_y, whole.kept_y), (fewer.kept_x, whole.kept_x))
    )
    torch.testing.assert_close(taken, own, rtol=1e-12, atol=0)
    torch.testing.assert_close(taken, every[:, rows][..., columns], rtol=1e-12, atol=0)


def test_stray_light_is_judged_behind_the_bayer_pattern() -> None:
    """Light that is nearly even is not read so: 8 x 10 sensor pixels make 3 x 4 unlike ones."""
    camera = small(panel=bare(1e-3, 1e-3), window=Window(1, 1), distance=5e-3)
    scene, embedding = Scene(1, 1, height=1e-3), Embedding(3, 4)
    built = Imperfections(stray_light=0.19)
    conditions = Conditions(bayer=True, imperfections=built)
    filters = replace(camera.panel, filter_cycle=(0,))
    red = replace(camera, panel=filters, sensor=Sensor(8, 10, 30e-6))
    chosen = plan(red, scene, embedding, 1e-2, conditions)
    judged = {each.name: each for each in chosen.assessments}["stray light"]
    sampling = Sampling(reach=Reach(0, 0), dtype=torch.float64)
    clean = Model(red, scene, embedding, Conditions(bayer=True), sampling)
    whole = replace(clean, conditions=conditions)
    weights = torch.ones(1, 1, dtype=torch.float64)
    measured = relative(LightOperator(clean)(weights), LightOperator(whole)(weights))
    assert measured > 0.03
    assert judged.error == pytest.approx(measured, rel=0.1)
    assert judged.matters
    even = replace(red, sensor=Sensor(6, 8, 35e-6))  # 2 x 2 pixels each: shares are alike
    found = {each.name: each for each in plan(even, scene, embedding, 1e-2, conditions).assessments}
    assert found["stray light"].error < measured / 5


def turned(rotation: float) -> Model:
    """Apertures of 49 x 58 um, of which the sensor 10 um behind them sees the edges alone."""
    panel = Panel(pitch_y=97e-6, pitch_x=97e-6, aperture_y=49e-6, aperture_x=58e-6, filter_cycle=())
    camera = Camera(
        panel=panel,
        window=Window(1, 2),
        sensor=Sensor(26, 19, 2.4e-6),
        distance=10e-6,
        wavelengths=(3.4e-6,) * 3,
    )
    conditions = Conditions(imperfections=Imperfections(rotation=rotation))
    scene = Scene(2, 1, height=0.05, distance=0.1)
    return Model(camera, scene, Embedding(1, 1), conditions, Sampling("grid"))


@pytest.mark.parametrize("rotation", [0.0, 0.15])
def test_grid_is_judged_by_finer_ones(rotation: float) -> None:
    model, weights = turned(rotation), torch.ones(1, 1, 2, dtype=torch.float64)
    errors = GridErrors(model, 1.0, weights)
    scenes = torch.eye(2, dtype=torch.float64).reshape(2, 2, 1)

    def light(oversampling: float) -> Tensor:
        sampling = replace(model.sampling, oversampling=oversampling, dtype=torch.float64)
        operator = LightOperator(replace(model, sampling=sampling))
        return operator.collect(scenes, operator.response(weights[0]))

    fine = light(32.0)
    for oversampling in OVERSAMPLINGS:
        measured = relative(light(oversampling), fine)
        assert measured / 2 < errors.at(oversampling)
    # The fit to what whole apertures do is far off where edges alone are seen.
    assert relative(light(1.0), fine) > 2 * grid_error(model, 1.0)


def test_grids_too_large_to_be_looked_at_are_estimated() -> None:
    """The default panel turned, to a hundredth of a sample: what is known is the fit."""
    conditions = Conditions(imperfections=Imperfections(rotation=0.1))
    model = Model(Camera(), Scene(), Embedding(), conditions, Sampling("grid"))
    errors = GridErrors(model, 30.0, torch.ones(2, *Camera().mask_shape, dtype=torch.float64))
    assert errors.at(30.0) == grid_error(model, 30.0)


def test_grids_are_not_looked_at_where_a_matrix_does(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: GridErrors, oversampling: float) -> float:
        raise AssertionError(oversampling)

    monkeypatch.setattr(GridErrors, "at", refuse)
    assert plan(small(), Scene(2, 3, height=0.02), Embedding(3, 4), 1e-2).reached
