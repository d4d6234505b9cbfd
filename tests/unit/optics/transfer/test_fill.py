"""Boxes smaller than their embedding pixels: every path, and the plan, average the same ones."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from benchmarks.accuracy.reference import reference_transfer
from tests.oracle.jobs import Job, masks
from tests.oracle.judge import computed, distance, truth
from tests.unit.optics.tensors import mask, relative
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import Conditions
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.effects.model import Method
from veilcam_optics.plan import plan
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.kernels import Approximation
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach

CAMERA = Camera(window=Window(rows=7, columns=3), sensor=Sensor(rows=488, columns=648))
SCENE = Scene(rows=4, columns=3, height=0.03)
SHAPE = 4, 5


def middles(finer: Tensor, parts: int, fill: float) -> Tensor:
    """Means over the middle of each embedding pixel, of as many as ``parts`` by ``parts``."""
    split = finer.reshape(len(finer), SHAPE[0], parts, SHAPE[1], parts)
    closed = round(parts * (1 - fill)) // 2
    inside = split[:, :, closed : parts - closed, :, closed : parts - closed]
    return inside.mean((2, 4)).reshape(len(finer), -1)


@pytest.mark.parametrize(("fill", "parts"), [(0.5, 4), (0.2, 5), (0.2, 10), (1 / 3, 3)])
@pytest.mark.parametrize("method", ["transfer", "factors", "grid"])
@pytest.mark.parametrize("bayer", [False, True])
def test_value_is_the_mean_over_the_middle_of_its_pixel(
    method: Method, bayer: bool, fill: float, parts: int
) -> None:
    # Of two sensor pixels to the smallest part, where every box has its colours in equal shares.
    rows, columns = (2 * parts * count for count in SHAPE)
    sensor = Sensor(rows, columns, 756.4e-6 / rows)
    oversampling = 8 * sensor.pixel / 12.4e-6
    sampling = Sampling(method, oversampling=oversampling, dtype=torch.float64)
    conditions = Conditions(bayer=bayer)
    lit = torch.eye(12, dtype=torch.float64).reshape(-1, *SCENE.shape)

    def seen(embedding: Embedding) -> Tensor:
        model = Model(replace(CAMERA, sensor=sensor), SCENE, embedding, conditions, sampling)
        operator = LightOperator(model)
        return operator.collect(lit, operator.response(mask(CAMERA))).flatten(1)

    finer = seen(Embedding(parts * SHAPE[0], parts * SHAPE[1]))
    small, full = seen(Embedding(*SHAPE, fill)), seen(Embedding(*SHAPE))
    assert relative(small, middles(finer, parts, fill)) < 1e-9
    assert relative(full, small) > 1e-2


def test_operator_of_small_boxes_agrees_with_the_whole_field() -> None:
    embedding = Embedding(*SHAPE, 0.1)
    truth_ = reference_transfer(CAMERA, SCENE, embedding, mask(CAMERA), oversampling=24)
    operator = TransferOperator(
        *(CAMERA, SCENE, embedding),
        reach=Reach(6, 2),
        step=0.4e-6,
        dtype=torch.float64,
        approximation=Approximation(axial=True),
    )
    assert relative(operator(mask(CAMERA)), truth_) < 1e-4


def test_smallest_box_is_a_point() -> None:
    """Differences over it keep their digits, however small it is."""
    found = [
        TransferOperator(CAMERA, SCENE, Embedding(*SHAPE, fill), dtype=torch.float64)(mask(CAMERA))
        for fill in (1e-3, 1e-12)
    ]
    assert relative(found[1], found[0]) < 1e-5


def test_plan_of_a_small_box_is_honest() -> None:
    """Fringes average out less in it; a plan that took it for a full one would be wrong."""
    camera = Camera(
        panel=Panel(4, 4, 25e-6, 25e-6, 20e-6, 20e-6, filter_cycle=()),
        window=Window(4, 4, 0, 0),
        sensor=Sensor(30, 30, 5e-6),
        distance=2e-3,
    )
    scene, small = Scene(2, 2, 0.02, 0.4), Embedding(2, 2, 0.1)
    chosen = plan(camera, scene, small, 1e-2)
    job = Job(camera, scene, small, Conditions(), 1e-2, ((5, 4), (5, 4)))
    exact, unsure = truth(job, masks(job), lambda _: 1e-3)
    found = distance(computed(chosen, masks(job)), exact)
    assert chosen.reached
    assert found - unsure < 2 * chosen.error
    blind = replace(chosen, model=replace(chosen.model, embedding=Embedding(2, 2)))
    assert distance(computed(blind, masks(job)), exact) > 0.1
