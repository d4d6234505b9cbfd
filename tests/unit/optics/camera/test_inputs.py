"""What comes in is refused alike at every door, with its name, unit and range."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import pytest
import torch
from benchmarks.accuracy.reference import reference_psf, reference_transfer
from tests.unit.optics.tensors import bare
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.errors import OpticsError
from veilcam_optics.plan import plan
from veilcam_optics.propagation import AngularSpectrum
from veilcam_optics.propagation.sampling import Grid
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.grid import GridLight
from veilcam_optics.transfer.operator import TransferOperator

CAMERA = Camera(
    panel=Panel(filter_cycle=()), window=Window(6, 3), sensor=Sensor(rows=200, columns=240)
)
SCENE = Scene(3, 4, height=0.02)
EMBEDDING = Embedding(3, 5)

Door = Callable[[Tensor], object]


def light(**sampling: object) -> LightOperator:
    return LightOperator(
        Model(CAMERA, SCENE, EMBEDDING, sampling=Sampling(**sampling))  # type: ignore[arg-type]
    )


@cache
def doors_of_masks() -> dict[str, Door]:
    scenes = torch.ones(1, *SCENE.shape)
    operator = TransferOperator(CAMERA, SCENE, EMBEDDING)
    grid = GridLight(CAMERA, SCENE, 1, dtype=torch.float32)
    transfer, factors, sampled = light(), light(method="factors"), light(method="grid")
    chosen = plan(CAMERA, SCENE, EMBEDDING, 0.3)
    return {
        "TransferOperator": operator,
        "TransferOperator.embed": lambda w: operator.embed(scenes, w),
        "TransferOperator.embed_by_factors": lambda w: operator.embed_by_factors(scenes, w),
        "GridLight.psf": grid.psf,
        "GridLight.mask": lambda w: grid.mask(w, 0),
        "LightOperator": transfer,
        "LightOperator.embed": lambda w: transfer.embed(scenes, w),
        "LightOperator.embed by factors": lambda w: factors.embed(scenes, w),
        "LightOperator.embed on a grid": lambda w: sampled.embed(scenes, w),
        "LightOperator.response": sampled.response,
        "Plan.transfer": chosen.transfer,
        "Plan.embed": lambda w: chosen.embed(scenes, w),
        "reference_transfer": lambda w: reference_transfer(
            CAMERA, SCENE, EMBEDDING, w, oversampling=1
        ),
        "reference_psf": lambda w: reference_psf(
            CAMERA, SCENE, w, Grid.square(3, 3, 1e-5), oversampling=1
        ),
    }


@cache
def doors_of_scenes() -> dict[str, Door]:
    weights = torch.full(CAMERA.mask_shape, 0.5)
    operator = TransferOperator(CAMERA, SCENE, EMBEDDING)
    coloured = TransferOperator(CAMERA, SCENE, EMBEDDING, colour=True)
    grid = GridLight(CAMERA, SCENE, 1, dtype=torch.float32)
    psf = grid.psf(weights)
    transfer, sampled = light(), light(method="grid")
    chosen = plan(CAMERA, SCENE, EMBEDDING, 0.3)

    def colours(scenes: Tensor) -> Tensor:
        return scenes[:, None].expand(-1, 3, -1, -1)

    return {
        "TransferOperator.embed": lambda x: operator.embed(x, weights),
        "TransferOperator.embed in colour": lambda x: coloured.embed(colours(x), weights),
        "TransferOperator.embed_by_factors": lambda x: operator.embed_by_factors(x, weights),
        "GridLight.embed": lambda x: grid.embed(x, psf, EMBEDDING),
        "GridLight.embed_colour": lambda x: grid.embed_colour(colours(x), psf, EMBEDDING),
        "LightOperator.embed": lambda x: transfer.embed(x, weights),
        "LightOperator.embed on a grid": lambda x: sampled.embed(x, weights),
        "LightOperator.collect": lambda x: transfer.collect(x, transfer.response(weights)),
        "Plan.embed": lambda x: chosen.embed(x, weights),
    }


def one_of(shape: tuple[int, ...], value: float) -> Tensor:
    values = torch.full(shape, 0.5)
    values.view(-1)[1] = value
    return values


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (2.0, r"hold [13] values outside \[0, 1\]"),
        (-1.0, r"hold [13] values outside \[0, 1\]"),
        (float("nan"), "hold NaN or infinity"),
        (float("inf"), "hold NaN or infinity"),
        (float("-inf"), "hold NaN or infinity"),
    ],
)
def test_values_that_cannot_be_are_refused_at_every_door(value: float, message: str) -> None:
    for name, door in doors_of_masks().items():
        with pytest.raises(OpticsError, match=f"weights {message}"):
            raise AssertionError(f"{name} took {door(one_of(CAMERA.mask_shape, value))}")
    for name, door in doors_of_scenes().items():
        with pytest.raises(OpticsError, match=f"scenes {message}"):
            raise AssertionError(f"{name} took {door(one_of((2, *SCENE.shape), value))}")


@pytest.mark.parametrize("dtype", [torch.int64, torch.uint8, torch.bool, torch.complex64])
def test_only_real_numbers_are_taken(dtype: torch.dtype) -> None:
    """A mask of levels, or a picture of bytes, is in another unit."""
    message = rf"\.dtype = {dtype} is not valid: use float32 or float64"
    for name, door in doors_of_masks().items():
        with pytest.raises(OpticsError, match="weights" + message):
            raise AssertionError(f"{name} took {door(torch.ones(CAMERA.mask_shape, dtype=dtype))}")
    for name, door in doors_of_scenes().items():
        with pytest.raises(OpticsError, match="scenes" + message):
            raise AssertionError(f"{name} took {door(torch.ones(1, *SCENE.shape, dtype=dtype))}")


@pytest.mark.parametrize("value", [0.0, 1.0, -1e-6, 1 + 1e-6])
def test_both_ends_are_taken_and_what_rounding_makes_of_them(value: float) -> None:
    for door in doors_of_masks().values():
        door(one_of(CAMERA.mask_shape, value))
    for door in doors_of_scenes().values():
        door(one_of((2, *SCENE.shape), value))


@pytest.mark.parametrize(
    "door",
    [
        lambda far: GridLight(far, SCENE),
        lambda far: LightOperator(Model(far, SCENE, EMBEDDING, sampling=Sampling(method="grid"))),
        lambda far: reference_transfer(far, SCENE, EMBEDDING, torch.ones(far.mask_shape)),
        lambda far: AngularSpectrum().prepare(
            Grid.square(10**6, 10**6, 1e-6), Grid.square(10**6, 10**6, 1e-6), 1.0, 1e-6
        ),
    ],
)
def test_sizes_beyond_memory_are_refused_beforehand(door: Callable[[Camera], object]) -> None:
    """The picture of a scene of 2 cm is 50 m wide, a kilometre behind the mask."""
    with pytest.raises(OpticsError, match=r"asks for .* bytes of this machine's"):
        door(replace(CAMERA, distance=1e3))


@pytest.mark.parametrize(
    "door",
    [
        lambda fine: GridLight(fine, SCENE, 4),
        lambda fine: LightOperator(
            Model(fine, SCENE, EMBEDDING, sampling=Sampling(method="grid", oversampling=4.0))
        ),
    ],
)
def test_grids_too_coarse_for_the_panel_are_refused(door: Callable[[Camera], object]) -> None:
    """Two samples across an aperture of 6.6 um are many per cent off."""
    panel = bare(8e-6, 6.56e-6)
    fine = replace(CAMERA, panel=panel)
    with pytest.raises(OpticsError, match=r"oversampling = 4.* at least 4\.54, for 2\.4 samples"):
        door(fine)
    assert GridLight(fine, SCENE, 4.6).grid.rows > 0
