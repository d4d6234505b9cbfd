"""The point spread function of a plan, and how a plan shows itself."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from benchmarks.accuracy.reference import reference_psf

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import Conditions, Imperfections
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.errors import OpticsError
from veilcam_optics.plan import plan
from veilcam_optics.propagation.sampling import Grid
from veilcam_optics.simulation.psf import psf, psf_shape
from veilcam_optics.transfer.tables import Reach

CAMERA = Camera(window=Window(6, 4), sensor=Sensor(rows=300, columns=400))
SCENE, EMBEDDING = Scene(2, 2, height=0.05), Embedding(3, 4)
FULL = Model(
    CAMERA,
    SCENE,
    EMBEDDING,
    Conditions(),
    Sampling(reach=Reach(5, 3), step=0.2e-6, dtype=torch.float64),
)
MASK = torch.rand(6, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def test_psf_is_that_of_the_reference() -> None:
    found = psf(FULL, MASK, 15)
    side = CAMERA.sensor.height / 15
    truth = reference_psf(CAMERA, SCENE, MASK, Grid.square(15, 20, side), oversampling=64)
    # Sixteen samples of a cell against sixty-four.
    assert float((found - truth).norm() / truth.norm()) < 2e-3


def test_psf_counts_the_panel_and_the_camera() -> None:
    gamma = replace(FULL, conditions=Conditions(imperfections=Imperfections(gamma=2.0)))
    assert torch.allclose(psf(gamma, MASK, 5), psf(FULL, MASK.square(), 5))
    shift = 3 * CAMERA.sensor.height / 15
    built = Imperfections(shift_y=shift / (1 + CAMERA.distance / SCENE.distance))
    moved = psf(replace(FULL, conditions=Conditions(imperfections=built)), MASK, 15)
    assert torch.allclose(moved[:, 3:], psf(FULL, MASK, 15)[:, :-3], atol=1e-3)
    spread = Conditions(bandwidth=(100e-9,) * 3, depth_range=0.1)
    sampled = replace(FULL, conditions=spread).with_sampling(wavelengths=3, layers=3)
    near = psf(sampled, MASK, 15), psf(FULL, MASK, 15)
    assert 1e-4 < float((near[0] - near[1]).norm() / near[1].norm()) < 0.3
    turned = replace(FULL, conditions=Conditions(imperfections=Imperfections(rotation=1e-3)))
    with pytest.raises(OpticsError, match="rotation"):
        psf(turned, MASK, 5)


def test_plan_has_one_and_its_gradient() -> None:
    chosen = plan(CAMERA, SCENE, EMBEDDING, 5e-2)
    weights = MASK.float().requires_grad_()
    found = chosen.psf(weights, 12)
    assert tuple(found.shape) == (3, 12, 16)
    assert psf_shape(CAMERA, 12) == (12, 16)
    torch.autograd.backward(found.sum())
    assert weights.grad is not None
    assert bool((weights.grad > 0).all())
    with pytest.raises(OpticsError, match="rows"):
        chosen.psf(weights, 0)
    with pytest.raises(OpticsError, match=r"weights\.shape"):
        chosen.psf(weights[1:])


def test_notebook_shows_the_same_as_the_explanation() -> None:
    bare = replace(CAMERA, panel=Panel(filter_cycle=()))
    chosen = plan(bare, SCENE, EMBEDDING, 5e-2)
    shown = chosen._repr_html_()
    assert shown.startswith("<pre>")
    assert "predicted error" in shown
    assert all(found.name in shown for found in chosen.assessments if found.present)
    assert "tensor(" not in shown
