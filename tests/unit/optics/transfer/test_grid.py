"""The grid path against the transfer operator, and the invariances it must have."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from tests.unit.optics.tensors import mask, relative, seeded
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.errors import OpticsError
from veilcam_optics.transfer.grid import GridLight
from veilcam_optics.transfer.kernels import Approximation
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach

CAMERA = Camera(
    panel=Panel(
        rows=24, columns=12, pitch_y=60e-6, pitch_x=90e-6, aperture_y=50e-6, aperture_x=70e-6
    ),
    window=Window(rows=7, columns=4, first_row=8, first_column=4),
    sensor=Sensor(rows=320, columns=402),
    distance=2e-3,
)
SCENE = Scene(rows=3, columns=5, height=0.015, distance=0.3)
EMBEDDING = Embedding(rows=6, columns=7)


def some_scenes(*shape: int) -> Tensor:
    return torch.rand(shape, generator=seeded(1), dtype=torch.float64)


@pytest.mark.slow
def test_converges_to_the_transfer_operator() -> None:
    """All pairs counted, which test_reference.py compares with the whole field."""
    operator = TransferOperator(
        *(CAMERA, SCENE, EMBEDDING),
        reach=Reach(7, 4),
        step=0.5e-6,
        dtype=torch.float64,
        approximation=Approximation(axial=True),
    )
    scene, weights, errors = some_scenes(*SCENE.shape), mask(CAMERA), []
    wanted = operator.embed(scene[None], weights)[0]
    for oversampling in (1, 2, 4, 8, 16):
        light = GridLight(CAMERA, SCENE, oversampling)
        errors.append(relative(light.embed(scene, light.psf(weights), EMBEDDING), wanted))
    assert errors == sorted(errors, reverse=True)
    assert errors[0] < 0.03
    assert errors[-1] < 0.007


@pytest.mark.parametrize("filters", [(), (0, 1, 2)])
def test_filter_keeps_only_its_rows(filters: tuple[int, ...]) -> None:
    panel = dataclasses.replace(CAMERA.panel, filter_cycle=filters)
    light = GridLight(dataclasses.replace(CAMERA, panel=panel), SCENE, 2)
    weights = torch.zeros(CAMERA.mask_shape, dtype=torch.float64)
    weights[2] = 1  # panel row 10: green
    powers = light.psf(weights).sum((1, 2))
    assert bool((powers > 0).tolist() == ([False, True, False] if filters else [True] * 3))


def test_energy_is_kept_by_propagation() -> None:
    light = GridLight(CAMERA, SCENE, 8)
    weights = mask(CAMERA)
    at_mask = torch.stack([light.mask(weights, c).square().sum() for c in range(3)])
    at_sensor = light.psf(weights).sum((1, 2))
    # A little is diffracted past the grid, none may appear.
    assert bool((at_sensor <= at_mask * (1 + 1e-9)).all())
    assert relative(at_sensor, at_mask) < 2e-2


def test_open_mask_irradiance_is_that_of_a_spherical_wave() -> None:
    panel = Panel(200, 200, 10e-6, 10e-6, 10e-6, 10e-6, filter_cycle=())
    camera = Camera(panel, Window(180, 180, 0, 0), Sensor(200, 200), distance=2e-3)
    light = GridLight(camera, Scene(2, 2, 1e-4, 0.05), 4)
    psf = light.psf(torch.ones(180, 180, dtype=torch.float64))
    middle = psf[:, psf.shape[1] // 2 - 12 : psf.shape[1] // 2 + 12, psf.shape[2] // 2]
    assert float(middle.mean()) == pytest.approx((0.05 / 0.052) ** 2, rel=5e-3)


def test_scene_shift_moves_the_image_the_other_way() -> None:
    side = 5 * 1.55e-6  # a scene pixel's image is one embedding pixel
    scene = Scene(64, 80, 64 * side * 0.3 / 2e-3, 0.3)
    embedding = Embedding(64, 80)
    camera = dataclasses.replace(CAMERA, sensor=Sensor(320, 400))
    light = GridLight(camera, scene, 2)
    psf = light.psf(mask(CAMERA))
    dots = torch.zeros(2, 64, 80, dtype=torch.float64)
    dots[0, 30, 40] = 1
    dots[1, 33, 35] = 1
    first, second = light.embed(dots, psf, embedding)
    assert relative(second[:-3, 5:], first[3:, :-5]) < 1e-10


def test_batch_equals_loop_and_colour_sums_to_gray() -> None:
    light = GridLight(CAMERA, SCENE, 1)
    psf = light.psf(mask(CAMERA))
    scenes = some_scenes(2, 9, *SCENE.shape)
    batch = light.embed(scenes, psf, EMBEDDING)
    assert batch.shape == (2, 9, 6, 7)
    assert relative(batch[1, 8], light.embed(scenes[1, 8], psf, EMBEDDING)) < 1e-12
    colour = light.embed_colour(scenes[:, :, None].expand(-1, -1, 3, -1, -1), psf, EMBEDDING)
    shares = torch.tensor(CAMERA.sensor.channel_weights, dtype=torch.float64)
    assert relative((colour * shares[:, None, None]).sum(-3), batch) < 1e-12
    gray = light.gray_psf_of_amplitudes(mask(CAMERA))
    assert gray.shape == light.grid.shape
    assert relative(light.embed_gray(scenes, gray, EMBEDDING), batch) < 1e-12
    assert light.embed(scenes[:, :0], psf, EMBEDDING).shape == (2, 0, 6, 7)


def test_average_over_the_sensor_does_not_depend_on_the_embedding() -> None:
    light = GridLight(CAMERA, SCENE, 1)
    psf, scene = light.psf(mask(CAMERA)), some_scenes(*SCENE.shape)
    one = light.embed(scene, psf, Embedding(1, 1))
    for embedding in (Embedding(7, 11), Embedding(1, 9), Embedding(320, 402)):
        assert float(light.embed(scene, psf, embedding).mean()) == pytest.approx(
            float(one), rel=1e-9
        )


def test_bad_input_is_refused_without_telling_the_weights() -> None:
    light = GridLight(CAMERA, SCENE, 1)
    secret = mask(CAMERA)
    secret[0, 0] = 1.375
    with pytest.raises(OpticsError, match=r"weights hold 1 values outside \[0, 1\]") as caught:
        light.psf(secret)
    assert "1.375" not in str(caught.value)
    with pytest.raises(OpticsError, match="NaN"):
        light.psf(torch.full(CAMERA.mask_shape, float("nan"), dtype=torch.float64))
    with pytest.raises(OpticsError, match=r"weights\.shape"):
        light.psf(secret.mT)
    psf, scenes = light.psf(mask(CAMERA)), some_scenes(3, 5)
    for embed, given, response, wrong in (
        (light.embed, scenes.mT, psf, "scenes"),
        (light.embed, scenes, psf[:1], "psf"),
        (light.embed_gray, scenes, psf, "psf"),
        (light.embed_colour, scenes, psf, "scenes"),
    ):
        with pytest.raises(OpticsError, match=rf"{wrong}\.shape"):
            embed(given, response, EMBEDDING)
    with pytest.raises(OpticsError, match="oversampling"):
        GridLight(CAMERA, SCENE, 0)
