"""Pairs of sub-pixels, stacked: many masks at once, and cameras of extreme shapes."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from benchmarks.accuracy.reference import reference_transfer
from tests.unit.optics.tensors import assert_same
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import Imperfections
from veilcam_optics.errors import OpticsError
from veilcam_optics.transfer import product
from veilcam_optics.transfer.kernels import Approximation
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.product import Measurement, Transfer
from veilcam_optics.transfer.tables import Reach

# Seven rows: three of one colour and two of each other, so that stacks are of several shapes.
CAMERA = Camera(window=Window(rows=7, columns=3), sensor=Sensor(rows=480, columns=640))
SCENE = Scene(rows=4, columns=3, height=0.03)
EMBEDDING = Embedding(rows=4, columns=5)
TURNED = Imperfections(rotation=1e-3)


def masks_of(camera: Camera, count: int) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.rand(count, *camera.mask_shape, generator=generator, dtype=torch.float64)


def make(*, colour: bool = False) -> TransferOperator:
    return TransferOperator(
        CAMERA, SCENE, EMBEDDING, reach=Reach(3, 1), step=3e-6, colour=colour, dtype=torch.float64
    )


@pytest.mark.parametrize("columns", [1, 2, 4, 6])
@pytest.mark.parametrize("numpy", [False, True])
def test_masks_together_whatever_the_width(columns: int, numpy: bool) -> None:
    """Rows of whole words are laid out in words: with and without a gradient, in both libraries."""
    operator = TransferOperator(
        CAMERA, SCENE, Embedding(3, columns), reach=Reach(3, 1), step=6e-6, dtype=torch.float64
    )
    masks = masks_of(CAMERA, 3)
    singles = torch.stack([operator(mask) for mask in masks])
    if numpy:
        tables = {name: table.numpy() for name, table in operator.transfer.arrays().items()}
        transfer = Transfer.from_arrays(CAMERA, SCENE, operator.embedding, tables)
        assert_same(torch.from_numpy(transfer(masks.numpy())), singles)
    else:
        assert_same(operator(masks), singles)
        assert_same(operator(masks.requires_grad_()).detach(), singles)


def test_more_masks_than_one_product_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    whole, masks = make(colour=True), masks_of(CAMERA, 5)
    together = whole(masks)
    # Two masks at once, so that the last one is alone.
    monkeypatch.setattr(product, "_NUMBERS_AT_ONCE", 2 * together[0, 0].numel() + 1)
    taken: list[int] = []
    transfer = Measurement.transfer

    def counted(measurement: Measurement[Tensor], weights: Tensor, y: slice, x: slice) -> Tensor:
        taken.append(weights.shape[1])
        return transfer(measurement, weights, y, x)

    monkeypatch.setattr(Measurement, "transfer", counted)
    assert_same(whole(masks), together)
    assert sorted(set(taken)) == [1, 2]


@pytest.mark.parametrize("colour", [False, True])
def test_gradient_of_masks_together(colour: bool) -> None:
    operator, masks = make(colour=colour), masks_of(CAMERA, 3).requires_grad_()
    probe = torch.rand(
        operator(masks).shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1)
    )
    (together,) = torch.autograd.grad((operator(masks) * probe).sum(), masks)
    for k in range(3):
        (alone,) = torch.autograd.grad((operator(masks[k]) * probe[k]).sum(), masks)
        assert_same(together[k], alone[k])


@pytest.mark.parametrize("shape", [(3, 7), (2, 7, 4), (2, 3, 7), (1, 2, 7, 3), (21,), (2, 21)])
def test_masks_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(OpticsError, match=r"weights\.shape = .*the window, \(7, 3\)"):
        make()(torch.ones(shape))


@pytest.mark.parametrize(
    ("window", "scene", "embedding"),
    [
        pytest.param(Window(1, 1), Scene(1, 1, height=0.03), Embedding(1, 1), id="one of each"),
        pytest.param(Window(1, 1), Scene(2, 3, height=0.03), Embedding(3, 2), id="a pinhole"),
        pytest.param(Window(1, 4), Scene(3, 1, height=0.03), Embedding(1, 5), id="a row"),
        pytest.param(Window(5, 1), Scene(1, 3, height=0.01), Embedding(4, 1), id="a column"),
        pytest.param(Window(4, 2), Scene(2, 2, height=0.03), Embedding(1, 1), id="a photodiode"),
    ],
)
@pytest.mark.parametrize("coloured", [False, True])
def test_extreme_shapes_agree_with_direct_integration(
    window: Window, scene: Scene, embedding: Embedding, coloured: bool
) -> None:
    """All pairs counted, against the converged integral over the whole field."""
    # Without filters and with one colour that counts, a measurement is of one wavelength.
    panel = Panel() if coloured else Panel(filter_cycle=())
    shares = (0.25, 0.5, 0.25) if coloured else (0.0, 1.0, 0.0)
    sensor = replace(CAMERA.sensor, channel_weights=shares)
    camera = Camera(panel=panel, window=window, sensor=sensor)
    weights = masks_of(camera, 1)
    operator = TransferOperator(
        camera,
        scene,
        embedding,
        reach=Reach(9, 9),
        step=0.5e-6,
        dtype=torch.float64,
        approximation=Approximation(axial=True),
    )
    truth = reference_transfer(camera, scene, embedding, weights[0])
    (found,) = operator(weights)
    assert found.shape == truth.shape
    assert float((found - truth).norm() / truth.norm()) < 1e-3


def test_pairs_do_not_depend_on_how_their_colours_are_stacked() -> None:
    """Rows of one shape or another, with a turned mask: each colour is as if it were alone."""
    masks = masks_of(CAMERA, 2)

    def transfer(shares: tuple[float, float, float], *, colour: bool) -> Tensor:
        operator = TransferOperator(
            replace(CAMERA, sensor=replace(CAMERA.sensor, channel_weights=shares)),
            SCENE,
            EMBEDDING,
            reach=Reach(3, 2),
            step=3e-6,
            colour=colour,
            dtype=torch.float64,
            imperfections=TURNED,
        )
        values: Tensor = operator(masks)
        return values

    gray = transfer((0.25, 0.5, 0.25), colour=False)
    alone = [
        transfer((float(k == 0), float(k == 1), float(k == 2)), colour=False) for k in range(3)
    ]
    assert_same(gray, 0.25 * alone[0] + 0.5 * alone[1] + 0.25 * alone[2])
    assert_same(transfer((0.25, 0.5, 0.25), colour=True), torch.stack(alone, dim=1))
