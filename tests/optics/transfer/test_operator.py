"""The transfer operator: agreement with direct integration, gradients, units, refusals."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.masks import random_mask
from veilcam_optics.errors import OpticsError
from veilcam_optics.transfer.factored import aperture_fields, fresnel_integral
from veilcam_optics.transfer.kernels import box_kernel
from veilcam_optics.transfer.operator import Reach, TransferOperator, Variables
from veilcam_optics.transfer.regions import Region

SMALL = Camera(window=Window(rows=6, columns=3), sensor=Sensor(rows=480, columns=640))
SCENE = Scene(rows=4, columns=3, height=0.03)
EMBEDDING = Embedding(rows=4, columns=5)


def mask(camera: Camera, seed: int = 0) -> Tensor:
    return random_mask(camera, torch.Generator().manual_seed(seed)).double()


def relative(value: Tensor, reference: Tensor) -> float:
    return float((value - reference).norm() / reference.norm())


def test_box_kernel_equals_a_dense_integral() -> None:
    start, step, pixel, image = -2e-3, 1e-6, 196e-6, 43e-6
    nodes = start + step * torch.arange(4001, dtype=torch.float64)
    products = torch.stack([torch.cos(nodes * 2e4), torch.exp(-((nodes / 4e-4) ** 2))], dim=1)
    offsets = torch.linspace(-1.5e-3, 1.5e-3, 37, dtype=torch.float64)
    distance = (offsets[:, None] - nodes).abs()
    kappa = ((pixel + image) / 2 - distance).clamp(0, min(pixel, image))
    dense = kappa @ products * step
    ours = box_kernel(offsets, products, start, step, pixel=pixel, image=image)
    assert relative(ours, dense) < 1e-4


def test_every_pair_within_reach_counts() -> None:
    """With all pairs kept, T is the box integral of the full intensity |F w G^T|^2."""
    weights = mask(SMALL)
    operator = TransferOperator(
        SMALL, SCENE, EMBEDDING, reach=Reach(6, 3), step=0.5e-6, dtype=torch.float64, colour=True
    )
    transfers = operator(weights)
    nodes_y = torch.arange(-500e-6, 500e-6, 1e-6, dtype=torch.float64)
    nodes_x = torch.arange(-700e-6, 700e-6, 1e-6, dtype=torch.float64)
    image = SCENE.pixel_at_sensor(SMALL)

    def boxes(nodes: Tensor, pixels: int, length: float, scene_pixels: int) -> Tensor:
        pixel = length / pixels
        o = (torch.arange(pixels) - (pixels - 1) / 2)[:, None] * pixel
        q = -(torch.arange(scene_pixels) - (scene_pixels - 1) / 2) * image
        offset = (o - q)[:, :, None] - nodes
        kappa = ((pixel + image) / 2 - offset.abs()).clamp(0, min(pixel, image))
        return kappa * 1e-6 / (pixel * scene_pixels * image)

    for channel in range(3):
        fields = [
            aperture_fields(
                nodes,
                torch.tensor(centres, dtype=torch.float64),
                width,
                wavelength=SMALL.wavelengths[channel],
                source_distance=SCENE.distance,
                distance=SMALL.distance,
            )
            for nodes, centres, width in (
                (nodes_y, SMALL.row_centres, SMALL.panel.aperture_y),
                (nodes_x, SMALL.column_centres, SMALL.panel.aperture_x),
            )
        ]
        open_rows = torch.tensor(SMALL.row_amplitudes(channel), dtype=torch.float64)
        field = fields[0] @ (open_rows[:, None] * weights).to(torch.complex128) @ fields[1].T
        psf = field.abs().square()
        box_y = boxes(nodes_y, EMBEDDING.rows, SMALL.sensor.height, SCENE.rows)
        box_x = boxes(nodes_x, EMBEDDING.columns, SMALL.sensor.width, SCENE.columns)
        reference = torch.einsum("ajy,yx,bkx->jkab", box_y, psf, box_x).reshape(12, 20)
        assert relative(transfers[channel], reference) < 1e-3


def test_dropping_far_pairs_costs_little_and_is_monotone() -> None:
    camera = Camera(panel=Panel(filter_cycle=()))
    weights = mask(camera)
    scene = Scene(rows=7, columns=7)

    def transfer(reach: Reach) -> Tensor:
        operator = TransferOperator(camera, scene, Embedding(), reach=reach, dtype=torch.float64)
        return torch.as_tensor(operator(weights))

    reference = transfer(Reach(6, 2))
    none, rows, both = (
        relative(transfer(reach), reference) for reach in (Reach(0, 0), Reach(1, 0), Reach(1, 1))
    )
    assert none > rows > both
    assert none < 2e-2
    assert rows < 2e-3


@pytest.mark.parametrize("colour", [False, True])
def test_gradient_for_the_mask(colour: bool) -> None:
    operator = TransferOperator(
        SMALL, SCENE, EMBEDDING, reach=Reach(3, 1), colour=colour, dtype=torch.float64
    )
    assert torch.autograd.gradcheck(operator, (mask(SMALL).requires_grad_(),))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("distance", 4e-3),
        ("pitch_y", 0.073e-3),
        ("pitch_x", 0.219e-3),
        ("shift_y", 1e-5),
        ("shift_x", -2e-5),
        ("wavelengths", [640e-9, 550e-9, 460e-9]),
    ],
)
def test_gradient_for_the_geometry(name: str, value: float | list[float]) -> None:
    weights = mask(SMALL)
    unit = torch.tensor(value, dtype=torch.float64)
    probe = torch.rand(12 * 20, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(1))

    def transfer(scale: Tensor) -> Tensor:
        operator = TransferOperator(
            SMALL,
            SCENE,
            EMBEDDING,
            reach=Reach(3, 1),
            step=3e-6,
            dtype=torch.float64,
            variables=Variables(**{name: unit * scale}),
        )
        return torch.as_tensor(operator(weights)).flatten() @ probe

    one = torch.ones_like(unit).requires_grad_()
    assert torch.autograd.gradcheck(transfer, (one,), eps=1e-6, atol=1e-6, rtol=1e-3)
    moved = transfer(torch.full_like(unit, 1.05))
    assert relative(moved, transfer(torch.ones_like(unit))) > 1e-5, f"{name} changes nothing"


def test_fresnel_integral_gradient_and_limit() -> None:
    t = torch.linspace(-3, 3, 13, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(fresnel_integral, (t,))
    far = fresnel_integral(torch.tensor([1e6], dtype=torch.float64))
    assert abs(complex(far) - (0.5 + 0.5j)) < 1e-6


def test_wide_open_aperture_passes_the_whole_wave() -> None:
    """A hole much wider than the Fresnel zones: magnitude 1 for a plane wave on the axis."""
    field = aperture_fields(
        torch.zeros(1, dtype=torch.float64),
        torch.zeros(1, dtype=torch.float64),
        1.0,
        wavelength=550e-9,
        source_distance=math.inf,
        distance=4e-3,
    )
    assert abs(abs(complex(field)) - 1) < 1e-3


def test_units_open_panel_without_gaps_reads_one() -> None:
    """White scene, no dead space, all open: the geometric shadow of an absent panel."""
    side = 0.5e-3
    panel = Panel(pitch_y=side, pitch_x=side, aperture_y=side, aperture_x=side, filter_cycle=())
    camera = Camera(panel=panel, window=Window(rows=16, columns=16))
    operator = TransferOperator(
        camera, Scene(rows=2, columns=2), Embedding(6, 8), reach=Reach(15, 15), step=6e-6
    )
    values = operator.embed(torch.ones(1, 2, 2), torch.ones(camera.mask_shape))[0]
    shadow = (0.4 / 0.404) ** 2
    assert float((values[2:4, 3:5] / shadow - 1).abs().max()) < 0.02


def test_scene_is_seen_inverted() -> None:
    """A pinhole shows the scene upside down: light from above falls below."""
    weights = torch.zeros(Camera().mask_shape)
    weights[25, 10:12] = 1
    operator = TransferOperator(Camera(), Scene(), Embedding())
    scene = torch.zeros(1, 28, 28)
    scene[0, 3, 14] = 1
    values = operator.embed(scene, weights)[0]
    assert int(values.sum(1).argmax()) > 12


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 1), (3, 4)])
def test_odd_even_and_single_pixels(shape: tuple[int, int]) -> None:
    """However the sensor is cut, the pixels' mean is the same light."""
    weights = mask(SMALL)
    whole = TransferOperator(SMALL, SCENE, Embedding(1, 1), dtype=torch.float64)(weights)
    cut = TransferOperator(SMALL, SCENE, Embedding(*shape), dtype=torch.float64)(weights)
    assert relative(cut.mean(1, keepdim=True), whole) < 2e-3


def test_colours_sum_to_gray_and_filters_part_them() -> None:
    weights = mask(SMALL)
    colour = TransferOperator(SMALL, SCENE, EMBEDDING, colour=True, dtype=torch.float64)(weights)
    gray = TransferOperator(SMALL, SCENE, EMBEDDING, dtype=torch.float64)(weights)
    shares = torch.tensor(SMALL.sensor.channel_weights, dtype=torch.float64)
    assert relative(torch.einsum("c,cpe->pe", shares, colour), gray) < 1e-12
    red_rows_closed = weights.clone()
    red_rows_closed[torch.tensor(SMALL.row_amplitudes(0)) == 1] = 0
    dark = TransferOperator(SMALL, SCENE, EMBEDDING, colour=True, dtype=torch.float64)
    assert float(dark(red_rows_closed)[0].abs().max()) == 0


@pytest.mark.parametrize("colour", [False, True])
def test_a_part_of_the_scene_is_a_part_of_the_transfer(colour: bool) -> None:
    camera, scene = Camera(), Scene(7, 9)
    operator = TransferOperator(
        camera, scene, Embedding(4, 5), reach=Reach(3, 1), step=6e-6, colour=colour
    )
    weights = random_mask(camera, torch.Generator().manual_seed(0))
    whole = operator(weights)
    of_pixels = whole.reshape(-1, 7, 9, 20)[:, 1:5, 4:9].reshape(*whole.shape[:-2], 20, 20)
    torch.testing.assert_close(operator(weights, Region(1, 4, 4, 5)), of_pixels)
    assert torch.equal(operator(weights, Region(0, 0, 7, 9)), whole)
    for bad in (Region(-1, 0, 2, 2), Region(0, 8, 2, 2), Region(6, 0, 2, 2), Region(0, 0, 0, 2)):
        with pytest.raises(OpticsError, match="a part of the scene's 7 x 9 pixels"):
            operator(weights, bad)


def test_leakage_brings_light_through_foreign_rows() -> None:
    leaky = Camera(panel=Panel(filter_leakage=0.1), window=SMALL.window, sensor=SMALL.sensor)
    weights = mask(SMALL)
    ideal = TransferOperator(SMALL, SCENE, EMBEDDING, dtype=torch.float64)(weights)
    real = TransferOperator(leaky, SCENE, EMBEDDING, dtype=torch.float64)(weights)
    assert relative(real, ideal) > 1e-2


def _wrong_shape() -> object:
    return TransferOperator(SMALL, SCENE, EMBEDDING)(torch.ones(2, 2))


def _nan_mask() -> object:
    weights = torch.ones(SMALL.mask_shape)
    weights[0, 0] = math.nan
    return TransferOperator(SMALL, SCENE, EMBEDDING)(weights)


@pytest.mark.parametrize(
    ("attempt", "word"),
    [
        (_wrong_shape, "window"),
        (_nan_mask, "NaN"),
        (lambda: TransferOperator(SMALL, SCENE, EMBEDDING, step=-1.0), "step = -1.0 m"),
        (lambda: TransferOperator(SMALL, SCENE, EMBEDDING, step=1e-12), "step = 1e-12 m .* memory"),
        (lambda: TransferOperator(SMALL, SCENE, EMBEDDING, reach=Reach(-1, 0)), "reach.rows"),
        (lambda: Camera(distance=-4e-3), "camera.distance = -0.004 m"),
        (lambda: Panel(aperture_y=1e-3), "at most the pitch"),
        (lambda: Embedding(0, 4), "embedding.rows = 0"),
        (lambda: Scene(height=math.nan), "scene.height"),
        (lambda: Window(rows=True), "window.rows"),
        (lambda: Camera(window=Window(rows=400)), "panel rows"),
        (lambda: Sensor(channel_weights=(1.0, 1.0, 1.0)), "sum to 1"),
    ],
)
def test_bad_input_is_named(attempt: Callable[[], object], word: str) -> None:
    with pytest.raises(OpticsError, match=word):
        attempt()
