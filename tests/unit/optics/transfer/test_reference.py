"""The reference against the transfer operator, which integrates by another route."""

from __future__ import annotations

import math

import pytest
import torch
from benchmarks.accuracy.reference import reference_psf, reference_transfer
from tests.unit.optics.tensors import mask, relative

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.propagation.sampling import Grid
from veilcam_optics.transfer.binning import TransferBinning
from veilcam_optics.transfer.kernels import Approximation
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach

SMALL = Camera(window=Window(rows=7, columns=3), sensor=Sensor(rows=488, columns=648))
SCENE = Scene(rows=4, columns=3, height=0.03)
EMBEDDING = Embedding(rows=4, columns=5)


@pytest.mark.thorough
def test_transfer_operator_agrees_at_24x32() -> None:
    """The main claim: few terms are within 3e-3 of the whole field sampled 16 times finer."""
    weights = mask(Camera())
    scene = Scene(rows=7, columns=7)
    truth = reference_transfer(Camera(), scene, Embedding(), weights, oversampling=16)
    axial = Approximation(axial=True)
    fast = TransferOperator(Camera(), scene, Embedding(), approximation=axial)(weights.float())
    assert relative(fast.double(), truth) < 3e-3
    assert relative(fast.double() * 1.01, truth) > 3e-3, "blind to one percent"


@pytest.mark.parametrize("panel", [Panel(), Panel(filter_cycle=()), Panel(filter_leakage=0.2)])
def test_all_terms_agree_far_better(panel: Panel) -> None:
    """With every pair of sub-pixels the two routes differ by their quadratures alone."""
    camera = Camera(panel=panel, window=SMALL.window, sensor=SMALL.sensor)
    weights = mask(camera)
    truth = reference_transfer(camera, SCENE, EMBEDDING, weights, oversampling=24, colour=True)
    operator = TransferOperator(
        camera,
        SCENE,
        EMBEDDING,
        reach=Reach(6, 2),
        step=0.4e-6,
        colour=True,
        dtype=torch.float64,
        approximation=Approximation(axial=True),
    )
    assert truth.shape == (3, 12, 20)
    assert relative(operator(weights), truth) < 3e-5


def test_gray_is_the_weighted_sum_of_colours() -> None:
    weights = mask(SMALL)
    colours = reference_transfer(SMALL, SCENE, EMBEDDING, weights, oversampling=4, colour=True)
    gray = reference_transfer(SMALL, SCENE, EMBEDDING, weights, oversampling=4)
    shares = torch.tensor(SMALL.sensor.channel_weights, dtype=torch.float64)
    assert relative(torch.einsum("c,cpe->pe", shares, colours), gray) < 1e-12


def test_finer_cells_converge() -> None:
    weights = mask(SMALL)
    coarse, middle, fine = (
        reference_transfer(SMALL, SCENE, EMBEDDING, weights, oversampling=n) for n in (2, 8, 32)
    )
    assert relative(coarse, fine) > 3 * relative(middle, fine)


@pytest.mark.parametrize("shape", [(61, 81), (60, 80), (1, 7)])
def test_psf_cells_hold_the_same_light_as_the_transfer(shape: tuple[int, int]) -> None:
    """Cells that cover the sensor: their mean is the measurement of a point by one big pixel."""
    weights = mask(SMALL)
    sensor = SMALL.sensor
    grid = Grid(*shape, sensor.height / shape[0], sensor.width / shape[1])
    oversampling = math.ceil(1000 / max(shape))
    psf = reference_psf(SMALL, SCENE, weights, grid, oversampling=oversampling)
    assert psf.shape == (3, *shape)
    point = Scene(rows=1, columns=1, height=1e-6)
    big_pixel = reference_transfer(
        SMALL, point, Embedding(1, 1), weights, oversampling=24, colour=True
    )
    assert relative(psf.mean((1, 2)), big_pixel.flatten()) < (2e-3 if shape[0] > 1 else 2e-1)


def test_transfer_from_a_finely_sampled_psf() -> None:
    weights = mask(SMALL)
    pitch = 3.1e-6
    grid = Grid.square(330, 410, pitch)
    psf = reference_psf(SMALL, SCENE, weights, grid, oversampling=6)
    transfer = TransferBinning(SMALL, SCENE, EMBEDDING, shape=grid.shape, pitch=pitch)(psf)
    truth = reference_transfer(SMALL, SCENE, EMBEDDING, weights, oversampling=24, colour=True)
    assert relative(transfer, truth) < 3e-3
