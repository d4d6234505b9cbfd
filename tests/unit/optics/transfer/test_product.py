"""Transfers in NumPy and in torch: one formula, so one result but for rounding."""

from __future__ import annotations

import random
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import Imperfections
from veilcam_optics.errors import OpticsError
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.product import Transfer
from veilcam_optics.transfer.regions import Region
from veilcam_optics.transfer.tables import Reach

Values = npt.NDArray[Any]
TYPES = {torch.float32: np.float32, torch.float64: np.float64}
JOBS = 24


@dataclass(frozen=True)
class Job:
    operator: TransferOperator
    masks: Tensor
    scenes: Tensor

    @property
    def in_numpy(self) -> Transfer[Values]:
        return numpy_of(self.operator)

    @property
    def bound(self) -> Values:
        """How far two results may be apart, element by element.

        A chain of products and sums of n terms, each rounded by at most u, in any order, is off by
        at most n u / (1 - n u) of the sum of the terms' absolute values (Higham 2002, section 3.1).
        """
        tables = {name: np.abs(table) for name, table in self.in_numpy.arrays().items()}
        transfer = self.operator.transfer
        absolute = Transfer.from_arrays(transfer.camera, transfer.scene, transfer.embedding, tables)
        pairs = max(measurement.rows.shape[1] for measurement in transfer.measurements)
        terms = (pairs + transfer.camera.window.columns + 4) * np.finfo(tables["rows_0"].dtype).eps
        return np.asarray(2 * terms * absolute(np.abs(self.masks.numpy())))


def numpy_of(operator: TransferOperator) -> Transfer[Values]:
    tables = {name: table.numpy() for name, table in operator.transfer.arrays().items()}
    return Transfer.from_arrays(operator.camera, operator.scene, operator.embedding, tables)


def draw(seed: int, dtype: torch.dtype) -> Job:
    """Any camera: one sub-pixel or many, one colour or three, turned, leaking, with dead rows."""
    drawn = random.Random(seed)
    window = Window(drawn.randint(1, 7), drawn.randint(1, 4), drawn.randint(0, 3), 2)
    cycle: tuple[int, ...] = drawn.choice([(), (2, 1, 0)])
    leakage = drawn.choice([0.0, 0.2]) if cycle else 0.0
    camera = Camera(
        panel=Panel(filter_cycle=cycle, filter_leakage=leakage),
        window=window,
        sensor=Sensor(rows=480, columns=640),
    )
    imperfections = Imperfections(
        rotation=drawn.choice([0.0, 1e-3]), shift_x=drawn.choice([0.0, 5e-5])
    )
    operator = TransferOperator(
        camera,
        Scene(drawn.choice([1, 2, 5]), drawn.choice([1, 3, 4]), height=0.03),
        Embedding(drawn.choice([1, 2, 4]), drawn.choice([1, 3, 5])),
        reach=Reach(drawn.randint(0, 4), drawn.randint(0, 2)),
        step=drawn.choice([6e-6, 1e-5]),
        colour=drawn.random() < 0.5,
        dtype=dtype,
        imperfections=imperfections,
    )
    generator = torch.Generator().manual_seed(seed)
    masks = torch.rand(3, *camera.mask_shape, generator=generator, dtype=dtype)
    masks[0, drawn.randrange(window.rows)] = 0  # a dead row
    masks[1] = 1
    channels = (3,) if operator.colour else ()
    scenes = torch.rand(2, *channels, *operator.scene.shape, generator=generator, dtype=dtype)
    scenes[..., 0] = 0  # dark pixels, which the product leaves out
    return Job(operator, masks, scenes)


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("seed", range(JOBS))
def test_numpy_and_torch_give_the_same_transfers(seed: int, dtype: torch.dtype) -> None:
    job = draw(seed, dtype)
    transfer, masks = job.in_numpy, job.masks.numpy()
    found, bound = transfer(masks), job.bound
    assert isinstance(found, np.ndarray)
    assert found.dtype == TYPES[dtype] == transfer.dtype
    assert (np.abs(found - job.operator(job.masks).numpy()) <= bound).all()
    assert found.any()
    for index, mask in enumerate(masks):
        alone = transfer(mask)
        assert (np.abs(alone - found[index]) <= bound[index]).all()
        assert (np.abs(alone - job.operator(job.masks[index]).numpy()) <= bound[index]).all()
    assert transfer(masks[:0]).shape == (0, *found.shape[1:])
    last = Region(job.operator.scene.rows - 1, 0, 1, job.operator.scene.columns)
    assert (
        np.abs(transfer(masks, last) - found[..., -last.columns :, :])
        <= bound[..., -last.columns :, :]
    ).all()


@pytest.mark.parametrize("seed", range(JOBS))
def test_numpy_and_torch_give_the_same_embeddings(seed: int) -> None:
    job = draw(seed, torch.float64)
    transfer, mask, scenes = job.in_numpy, job.masks[0].numpy(), job.scenes.numpy()
    wanted = job.operator.embed(job.scenes, job.masks[0]).numpy()
    # Of at most 20 pixels of at most 1, each with the error of its transfer and a rounding.
    bound = 20 * (float(job.bound[0].max()) + 40 * 2.3e-16 * float(np.abs(wanted).max(initial=0)))
    for embed in (transfer.embed, transfer.embed_by_factors):
        found = embed(scenes, mask)
        assert isinstance(found, np.ndarray)
        assert found.shape == wanted.shape
        assert np.abs(found - wanted).max() <= bound
        assert embed(scenes[:0], mask).shape == (0, *wanted.shape[1:])


@pytest.mark.parametrize("seed", range(JOBS))
def test_gradient_of_torch_is_the_slope_of_numpy(seed: int) -> None:
    """A transfer is quadratic in the mask: a central difference is exact, however long its step."""
    job = draw(seed, torch.float64)
    mask = (0.25 + job.masks[2] / 2).requires_grad_()
    generator = torch.Generator().manual_seed(seed)
    direction = torch.rand(mask.shape, generator=generator, dtype=mask.dtype) - 0.5
    transfer = job.operator(mask)
    probe = torch.rand(transfer.shape, generator=generator, dtype=mask.dtype)
    (gradient,) = torch.autograd.grad((transfer * probe).sum(), mask)
    ends = [
        float((job.in_numpy((mask.detach() + sign * direction / 4).numpy()) * probe.numpy()).sum())
        for sign in (1, -1)
    ]
    # Of sums of so many parts: two for the ends, each doubled, and the gradient's own, which is a
    # sum of two such products.
    bound = transfer.numel() * float(job.bound.max())
    assert float((gradient * direction).sum()) == pytest.approx(
        (ends[0] - ends[1]) * 2, abs=6 * bound
    )


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("rows", [1, 3])
def test_tables_are_put_together_again(rows: int, colour: bool) -> None:
    operator = TransferOperator(
        Camera(window=Window(7, 3), sensor=Sensor(rows=480, columns=640)),
        Scene(4, 3, height=0.03),
        Embedding(4, 5),
        reach=Reach(rows, 1),
        step=6e-6,
        colour=colour,
    )
    transfer = operator.transfer
    again = Transfer.from_arrays(
        transfer.camera, transfer.scene, transfer.embedding, transfer.arrays()
    )
    assert again == replace(transfer, measurements=again.measurements)
    assert again.colour == colour
    for one, other in zip(transfer.measurements, again.measurements, strict=True):
        assert one.rows is other.rows
        kinds = [{(stack.offset, stack.squares) for stack in each.stacks} for each in (one, other)]
        # Rows with themselves, and three apart with another of their colour; also a column apart.
        assert kinds[0] == kinds[1] == {(0, rows == 1), (1, False)}
    assert dict(operator.named_buffers()) == transfer.arrays()


def test_module_that_is_moved_computes_on_what_it_holds_then() -> None:
    job = draw(3, torch.float64)
    job.operator.float()
    buffers = dict(job.operator.named_buffers())
    held = job.operator.transfer.arrays()
    assert buffers.keys() == held.keys()
    assert all(buffers[name] is held[name] for name in held)
    assert job.operator.dtype == torch.float32


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        (np.ones((2, 2)), "window"),
        (np.ones((7, 3), np.int64), "dtype = int64 is not valid: use float32 or float64"),
        (np.full((7, 3), 2.0), "hold 21 values outside"),
        (np.full((7, 3), np.nan), "NaN"),
    ],
)
def test_numpy_is_refused_what_torch_is_refused(weights: Values, message: str) -> None:
    camera = Camera(window=Window(7, 3), sensor=Sensor(rows=480, columns=640))
    operator = TransferOperator(camera, Scene(2, 2, height=0.03), Embedding(2, 2), step=6e-6)
    with pytest.raises(OpticsError, match=message):
        numpy_of(operator)(weights)
    with pytest.raises(OpticsError, match=message.replace("int64", "torch.int64")):
        operator(torch.from_numpy(weights))
