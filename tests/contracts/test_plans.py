"""A plan computes what the plain operators compute at the same settings, every time."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import IDEAL, Conditions
from veilcam_optics.errors import OpticsError
from veilcam_optics.plan import Plan, plan
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.operator import TransferOperator

from .contracts import relative
from .setting import Setting

TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4)
CAMERAS = {
    "small": Setting().camera(),
    "filters": Setting().camera(filters=True, leakage=0.1),
    "LCD": Camera(window=Window(9, 4, 180, 74), sensor=Sensor(480, 640)),
    "LCD without filters": Camera(Panel(filter_cycle=()), Window(9, 4, 180, 74), Sensor(480, 640)),
}
cameras = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())
tolerances = pytest.mark.parametrize("tolerance", TOLERANCES)


def scene_for(camera: Camera) -> Scene:
    return Setting().scene() if camera.distance == Setting().distance else Scene(3, 4, 0.05)


def some_weights(camera: Camera, dtype: torch.dtype, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(camera.mask_shape, generator=generator, dtype=torch.float64).to(dtype)


def some_scenes(scene: Scene, dtype: torch.dtype) -> Tensor:
    generator = torch.Generator().manual_seed(1)
    return torch.rand(5, *scene.shape, generator=generator, dtype=torch.float64).to(dtype)


def made(camera: Camera, tolerance: float, conditions: Conditions = IDEAL) -> Plan:
    return plan(camera, scene_for(camera), Embedding(4, 5), tolerance, conditions, batch=5)


@pytest.mark.thorough
@cameras
@tolerances
def test_plan_equals_no_plan(camera: Camera, tolerance: float) -> None:
    """The same operator put together by hand from the plan's sampling, without effects or plans."""
    chosen = made(camera, tolerance)
    sampling, model = chosen.model.sampling, chosen.model
    assert sampling.method in {"transfer", "factors"}
    by_hand = TransferOperator(
        model.camera,
        model.scene,
        model.embedding,
        reach=sampling.reach,
        step=sampling.step,
        dtype=sampling.dtype,
        approximation=model.approximation,
    )
    weights = some_weights(camera, sampling.dtype)
    scenes = some_scenes(model.scene, sampling.dtype)
    planned = chosen.embed(scenes, weights)
    assert planned.dtype == sampling.dtype
    # Zones are shifted by zero, which may round differently.
    precision = 10 * torch.finfo(sampling.dtype).eps
    assert relative(planned, by_hand.embed(scenes, weights)) < precision
    if sampling.method == "transfer":
        assert relative(chosen.transfer(weights), by_hand(weights)) < precision


@pytest.mark.slow
@cameras
def test_made_once_or_anew_and_used_again(camera: Camera) -> None:
    """No state is left behind by another mask, another scene or an empty batch."""
    chosen, again = made(camera, 1e-3), made(camera, 1e-3)
    assert chosen.model == again.model
    dtype = chosen.model.sampling.dtype
    weights, scenes = some_weights(camera, dtype), some_scenes(chosen.model.scene, dtype)
    first = chosen.embed(scenes, weights)
    chosen.embed(scenes.flip(0), some_weights(camera, dtype, seed=3))
    assert chosen.embed(scenes[:0], weights).shape == (0, 4, 5)
    assert torch.equal(chosen.embed(scenes, weights), first)
    assert torch.equal(again.embed(scenes, weights), first)
    assert torch.equal(LightOperator(chosen.model).embed(scenes, weights), first)
    one_by_one = torch.cat([chosen.embed(scene[None], weights) for scene in scenes])
    assert relative(one_by_one, first) < 10 * torch.finfo(dtype).eps


@pytest.mark.slow
def test_noise_of_a_plan_is_noise_after_the_optics() -> None:
    camera = CAMERAS["small"]
    chosen = made(camera, 1e-4, Conditions(snr_db=30.0))
    bare = made(camera, 1e-4)
    dtype = chosen.model.sampling.dtype
    assert bare.model.sampling.dtype == dtype
    weights, scenes = some_weights(camera, dtype), some_scenes(chosen.model.scene, dtype)
    noisy = chosen.embed(scenes, weights, torch.Generator().manual_seed(4))
    by_hand = shot_noise(
        LightOperator(replace(chosen.model, conditions=IDEAL)).embed(scenes, weights),
        30.0,
        torch.Generator().manual_seed(4),
    )
    assert torch.equal(noisy, by_hand)


@pytest.mark.parametrize("tolerance", [0.0, -1e-3, 1.0, math.nan, math.inf])
def test_impossible_tolerances_are_refused(tolerance: float) -> None:
    with pytest.raises(OpticsError, match="tolerance"):
        made(CAMERAS["small"], tolerance)
