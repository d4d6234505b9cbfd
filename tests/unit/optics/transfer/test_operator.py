"""The transfer operator: agreement with direct integration, gradients, units, refusals."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from tests.unit.optics.tensors import assert_same, bare, mask, relative, seeded
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.camera.masks import random_mask
from veilcam_optics.errors import OpticsError
from veilcam_optics.transfer.kernels import Approximation
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.regions import Region
from veilcam_optics.transfer.tables import Beam, Reach, Variables

SMALL = Camera(window=Window(rows=6, columns=3), sensor=Sensor(rows=480, columns=640))
LEAKY = replace(SMALL, panel=Panel(filter_leakage=0.1))
SCENE = Scene(rows=4, columns=3, height=0.03)
EMBEDDING = Embedding(rows=4, columns=5)
AXIAL = Approximation(axial=True)


def made(
    camera: Camera = SMALL, embedding: Embedding = EMBEDDING, **options: Any
) -> TransferOperator:
    options.setdefault("approximation", AXIAL)
    return TransferOperator(camera, SCENE, embedding, dtype=torch.float64, **options)


@pytest.mark.slow
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
    probe = torch.rand(12 * 20, 4, dtype=torch.float64, generator=seeded(1))

    def transfer(scale: Tensor) -> Tensor:
        operator = made(reach=Reach(3, 1), step=3e-6, variables=Variables(**{name: unit * scale}))
        return torch.as_tensor(operator(weights)).flatten() @ probe

    one = torch.ones_like(unit).requires_grad_()
    assert torch.autograd.gradcheck(transfer, (one,), eps=1e-6, atol=1e-6, rtol=1e-3)
    moved = transfer(torch.full_like(unit, 1.05))
    assert relative(moved, transfer(torch.ones_like(unit))) > 1e-5, f"{name} changes nothing"


def test_units_open_panel_without_gaps_reads_one() -> None:
    """White scene, no dead space, all open: the geometric shadow of an absent panel."""
    side = 0.5e-3
    panel = bare(side, side)
    camera = Camera(panel=panel, window=Window(rows=16, columns=16))
    operator = TransferOperator(
        camera,
        Scene(rows=2, columns=2),
        Embedding(6, 8),
        reach=Reach(15, 15),
        step=6e-6,
        approximation=AXIAL,
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


@pytest.mark.parametrize("colour", [False, True])
def test_part_of_the_scene_is_a_part_of_the_transfer(colour: bool) -> None:
    camera, scene = Camera(), Scene(7, 9)
    operator = TransferOperator(
        camera, scene, Embedding(4, 5), reach=Reach(3, 1), step=6e-6, colour=colour
    )
    weights = random_mask(camera, seeded(0))
    whole = operator(weights)
    of_pixels = whole.reshape(-1, 7, 9, 20)[:, 1:5, 4:9].reshape(*whole.shape[:-2], 20, 20)
    torch.testing.assert_close(operator(weights, Region(1, 4, 4, 5)), of_pixels)
    assert torch.equal(operator(weights, Region(0, 0, 7, 9)), whole)
    for bad in (Region(-1, 0, 2, 2), Region(0, 8, 2, 2), Region(6, 0, 2, 2), Region(0, 0, 0, 2)):
        with pytest.raises(OpticsError, match="a part of the scene's 7 x 9 pixels"):
            operator(weights, bad)


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("count", [0, 1, 5])
def test_embedding_is_a_scene_times_the_transfer(colour: bool, count: int) -> None:
    operator = made(reach=Reach(3, 1), colour=colour)
    weights = mask(SMALL)
    channels, sum_up = ((3,), "bcyx,cyxij->bcij") if colour else ((), "byx,yxij->bij")
    generator = seeded(4)
    scenes = torch.rand(count, *channels, *SCENE.shape, generator=generator, dtype=torch.float64)
    transfer = operator(weights).reshape(*channels, *SCENE.shape, *EMBEDDING.shape)
    wanted = torch.einsum(sum_up, scenes, transfer)
    for embed in (operator.embed, operator.embed_by_factors):
        assert_same(embed(scenes, weights), wanted)


@pytest.mark.parametrize("colour", [False, True])
def test_scenes_of_another_shape_are_refused(colour: bool) -> None:
    operator = TransferOperator(SMALL, SCENE, EMBEDDING, colour=colour)
    wrong = [(2, 3, 4), (2, 12), (2, 2, 4, 3), (4, 3), (2, 4, 4, 3)]
    wrong.append((2, 4, 3) if colour else (2, 3, 4, 3))
    for shape in wrong:
        for embed in (operator.embed, operator.embed_by_factors):
            with pytest.raises(OpticsError, match=r"scenes\.shape"):
                embed(torch.zeros(shape), mask(SMALL))
    with pytest.raises(OpticsError, match="window"):
        operator.embed_by_factors(torch.zeros(2, *((3,) if colour else ()), 4, 3), torch.ones(2, 2))


def test_scene_elsewhere_is_a_part_of_a_larger_one() -> None:
    large, weights = Scene(rows=9, columns=8, height=9 * SCENE.pixel), mask(SMALL)

    def make(scene: Scene, centre: tuple[float, float]) -> TransferOperator:
        return TransferOperator(
            SMALL,
            scene,
            EMBEDDING,
            reach=Reach(3, 1),
            step=0.5e-6,
            dtype=torch.float64,
            centre=centre,
        )

    for top, left in ((0, 0), (1, 5), (5, 2)):
        # From the middle of the large scene to that of the part, in whole and half pixels.
        centre = ((top + 2 - 4.5) * SCENE.pixel, (left + 1.5 - 4) * SCENE.pixel)
        part = make(large, (0.0, 0.0))(weights, Region(top, left, 4, 3))
        # Both are relative to a white scene of their own size. Between the nodes of the integral,
        # which lie elsewhere, the fields are smooth on the scale of a step: far below 1e-6.
        assert relative(make(SCENE, centre)(weights), part * 72 / 12) < 1e-6


@pytest.mark.parametrize(
    ("camera", "pairs"), [(SMALL, Reach(0, 0)), (SMALL, Reach(3, 1)), (LEAKY, Reach(0, 0))]
)
def test_rotation_has_a_gradient_also_at_zero(camera: Camera, pairs: Reach) -> None:
    angle, weights = 1e-5, mask(camera)
    straight, turned = (
        made(camera, reach=pairs, step=3e-6, imperfections=Imperfections(rotation=rotation))(
            weights
        )
        for rotation in (0.0, angle)
    )
    slope = (turned - straight) / angle
    # A tensor takes the same way, at an angle of zero too.
    zero = torch.zeros((), dtype=torch.float64, requires_grad=True)
    probe = torch.arange(float(EMBEDDING.size), dtype=torch.float64)
    found = made(camera, reach=pairs, step=3e-6, variables=Variables(rotation=zero))(weights)
    assert_same(found.detach(), straight)
    (gradient,) = torch.autograd.grad((found @ probe).sum(), zero)
    assert float(gradient) == pytest.approx(float((slope @ probe).sum()), rel=1e-6)


def test_rotation_and_its_mirror_image() -> None:
    """A mask and camera flipped left to right, and turned the other way, flip the embedding."""
    weights, angle = mask(SMALL), 3e-2
    one, other = (
        made(reach=Reach(3, 2), imperfections=Imperfections(rotation=rotation))(flipped).reshape(
            4, 3, 4, 5
        )
        for rotation, flipped in ((angle, weights), (-angle, weights.flip(1)))
    )
    # The same sums in another order, of terms some of which cancel.
    assert relative(other.flip(1, 3), one) < 1e-9


def test_beams_are_added_up_by_their_shares() -> None:
    weights = mask(SMALL)
    red, green, blue = SMALL.wavelengths

    def transfer(*beams: Beam, colour: bool = True) -> Tensor:
        operator = made(reach=Reach(3, 1), colour=colour, beams=beams or None)
        result: Tensor = operator(weights)
        return result

    one, two = Beam(1, green), Beam(1, 1.1 * green)
    rest = (Beam(0, red), Beam(2, blue))
    first, second = transfer(one, *rest), transfer(two, *rest)
    assert_same(first, transfer())
    assert relative(second[1], first[1]) > 1e-4
    both = transfer(replace(one, share=0.25), *rest, replace(two, share=0.75))
    assert_same(both[1], 0.25 * first[1] + 0.75 * second[1])
    assert_same(both[0], first[0])
    gray = transfer(replace(one, share=0.25), *rest, replace(two, share=0.75), colour=False)
    shares = torch.tensor(SMALL.sensor.channel_weights, dtype=torch.float64)
    assert_same(gray, torch.einsum("c,cpe->pe", shares, both))
    with pytest.raises(OpticsError, match="at least one for each of R, G and B"):
        transfer(one, two)
    with pytest.raises(OpticsError, match="at least one for each of R, G and B"):
        transfer(one, *rest, Beam(3, green))


def test_beam_that_is_stretched_both_ways_is_one_of_a_longer_wavelength() -> None:
    weights = mask(SMALL)

    def transfer(wavelength: float, stretch: tuple[float, float]) -> Tensor:
        beams = [Beam(channel, wavelength, stretch=stretch) for channel in range(3)]
        operator = made(beams=beams)
        result: Tensor = operator(weights)
        return result

    assert_same(transfer(500e-9, (1.2, 1.2)), transfer(600e-9, (1.0, 1.0)))
    # One sub-pixel alone: what spreads along one axis leaves the other's profile as it is.
    weights = torch.zeros_like(weights)
    weights[2, 1] = 1
    along_y, along_x = transfer(500e-9, (1.2, 1.0)), transfer(500e-9, (1.0, 1.2))
    (plain_y, plain_x), stretched_y, stretched_x = map(
        profiles, (transfer(500e-9, (1.0, 1.0)), along_y, along_x)
    )
    assert_same(stretched_y[1], plain_x)
    assert_same(stretched_x[0], plain_y)
    assert relative(stretched_y[0], plain_y) > 1e-4
    assert relative(stretched_x[1], plain_x) > 1e-4


def profiles(transfer: Tensor) -> list[Tensor]:
    shared = (transfer / transfer.sum()).reshape(*SCENE.shape, *EMBEDDING.shape)
    return [shared.sum((1, 3)), shared.sum((0, 2))]


def test_beam_comes_from_its_own_distance() -> None:
    weights = mask(SMALL)
    near = replace(SCENE, distance=0.1)
    beams = [
        Beam(channel, wavelength, scene_distance=0.1)
        for channel, wavelength in enumerate(SMALL.wavelengths)
    ]
    moved = made(beams=beams)(weights)
    operator = TransferOperator(SMALL, near, EMBEDDING, dtype=torch.float64, approximation=AXIAL)
    assert_same(moved, operator(weights))


@pytest.mark.parametrize("rows", [1, 2])
def test_colour_that_no_row_passes_is_dark(rows: int) -> None:
    camera = Camera(window=Window(rows, 3, 0, 5), sensor=SMALL.sensor)
    weights = torch.ones(camera.mask_shape, dtype=torch.float64)
    operator = made(camera, reach=Reach(3, 1), colour=True)
    lit = operator(weights).abs().amax((1, 2)) > 0
    assert lit.tolist() == [True, rows > 1, False]
    assert not operator.embed_by_factors(torch.ones(2, 3, 4, 3).double(), weights)[:, 2].any()


def test_colour_that_the_sensor_does_not_see_costs_nothing() -> None:
    blind = replace(SMALL, sensor=replace(SMALL.sensor, channel_weights=(0.0, 1.0, 0.0)))
    gray, seen = (made(blind, colour=colour) for colour in (False, True))
    torch.testing.assert_close(gray(mask(SMALL)), seen(mask(SMALL))[1])
    sizes = [sum(buffer.numel() for buffer in each.buffers()) for each in (gray, seen)]
    assert 2 * sizes[0] < sizes[1]


def test_operator_counts_pairs_by_default() -> None:
    assert (Reach().rows, Reach().columns) == (1, 0)
    beam = Beam(0, 500e-9)
    assert (beam.share, beam.scene_distance, beam.stretch) == (1.0, None, (1.0, 1.0))
    weights = mask(SMALL)
    given = TransferOperator(
        SMALL,
        SCENE,
        EMBEDDING,
        reach=Reach(1, 0),
        step=1.55e-6,
        centre=(0.0, 0.0),
        imperfections=NOMINAL,
    )
    found = TransferOperator(SMALL, SCENE, EMBEDDING)
    assert torch.equal(found(weights.float()), given(weights.float()))
    assert found(weights.float()).dtype == torch.float32


def test_buffers_move_with_the_operator() -> None:
    operator = TransferOperator(SMALL, SCENE, EMBEDDING, reach=Reach(3, 1))
    names = {name.partition("_")[0] for name, _ in operator.named_buffers()}
    assert names == {"first", "second", "columns", "rows", "fade"}
    assert operator.double()(mask(SMALL)).dtype == torch.float64


@pytest.mark.parametrize(
    ("attempt", "word"),
    [
        (lambda: TransferOperator(SMALL, SCENE, EMBEDDING, step=-1.0), "step = -1.0 m"),
        (lambda: TransferOperator(SMALL, SCENE, EMBEDDING, step=1e-12), "step = 1e-12 m .* memory"),
        (lambda: TransferOperator(SMALL, SCENE, EMBEDDING, step=0.0), "step = 0.0 m"),
        (lambda: TransferOperator(SMALL, SCENE, EMBEDDING, reach=Reach(-1, 0)), "reach.rows"),
        (lambda: TransferOperator(SMALL, SCENE, EMBEDDING, reach=Reach(0, -1)), "reach.columns"),
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
