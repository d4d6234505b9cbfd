"""Plans against exact light, and the bounds that they rest on against what they bound."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.oracle.jobs import Job, masks
from tests.oracle.judge import computed, truth
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import PARAXIAL, Conditions
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.plan import plan
from veilcam_optics.plan.bounds import far_pairs
from veilcam_optics.plan.probe import Probe
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.operator import Reach


def square(pitch: float, parts: int = 1, open_parts: int = 1) -> Panel:
    """A panel of square sub-pixels without filters."""
    side = pitch * open_parts / parts
    return Panel(pitch_y=pitch, pitch_x=pitch, aperture_y=side, aperture_x=side, filter_cycle=())


def error(value: Tensor, reference: Tensor) -> float:
    return float((value - reference).norm() / reference.norm())


@pytest.mark.slow
def test_fine_pitch_is_not_said_to_be_reached_where_it_is_not() -> None:
    """Fringes of 64 x 64 sub-pixels of 3 um, 2 mm away, are wider than a pixel."""
    camera = Camera(
        panel=square(3e-6), window=Window(64, 64), sensor=Sensor(16, 16, 8e-6), distance=2e-3
    )
    scene, embedding = Scene(2, 2, height=0.005), Embedding(16, 16)
    chosen = plan(camera, scene, embedding, 1e-2)
    job = Job(camera, scene, embedding, Conditions(), 1e-2, ((1, 1), (1, 1)))
    weights = masks(job)
    exact, unsure = truth(job, weights, lambda _: 1e-4)
    found = float(np.linalg.norm(computed(chosen, weights) - exact) / np.linalg.norm(exact))
    assert unsure < found / 10
    assert found < 2 * chosen.error
    assert not chosen.reached or found < 3e-2


def test_effects_are_judged_with_the_interference_that_is_there() -> None:
    """In the mid-infrared every pair of 10 columns of 25 um makes fringes wider than a pixel."""
    camera = Camera(
        panel=square(25e-6),
        window=Window(8, 10),
        sensor=Sensor(24, 24, 8e-6),
        distance=1.2e-3,
        wavelengths=(5e-6,) * 3,
    )
    scene, embedding = Scene(3, 3, height=0.02), Embedding(12, 12)
    chosen = plan(camera, scene, embedding, 1e-3, PARAXIAL)
    sampling = Sampling(reach=Reach(7, 9), dtype=torch.float64)
    whole = Model(camera, scene, embedding, PARAXIAL, sampling)
    points = replace(whole, sampling=replace(sampling, binning=False))
    weights = torch.rand(8, 10, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    measured = error(LightOperator(points)(weights), LightOperator(whole)(weights))
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
    panel = Panel(
        pitch_y=pitch,
        pitch_x=pitch,
        aperture_y=fill * pitch,
        aperture_x=fill * pitch,
        filter_cycle=(),
    )
    camera = Camera(
        panel=panel,
        window=Window(9, 1),
        sensor=Sensor(16, 16, 9 * pitch * side / 16),
        distance=(fill * pitch) ** 2 / wavelength / fresnel,
        wavelengths=(wavelength,) * 3,
    )
    scene = Scene(2, 1, height=2e3 * angle, distance=1e3)
    model = Model(camera, scene, Embedding(pixels, 1), PARAXIAL)
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
        panel=square(3e-6), window=Window(4, 4), sensor=Sensor(8, 8, 3e-6), distance=60e-6
    )
    chosen = plan(camera, Scene(2, 2, height=0.02), Embedding(2, 2), 1e-3, method=method)  # type: ignore[arg-type]
    found = {each.name: each for each in chosen.assessments}["non-paraxial diffraction"]
    assert found.error > 1e-3
    assert found.matters == (method == "grid")
    assert method == "grid" or chosen.error >= found.error
