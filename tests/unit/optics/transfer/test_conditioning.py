"""Directions of a transfer matrix, compared with those of random masks."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import torch

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Window
from veilcam_optics.errors import OpticsError
from veilcam_optics.transfer.conditioning import ConditioningMeter
from veilcam_optics.transfer.operator import TransferOperator

CAMERA = Camera()
Values = npt.NDArray[np.float32]


@pytest.fixture(scope="module")
def meter() -> ConditioningMeter:
    return ConditioningMeter(CAMERA, Scene(), Embedding(12, 16))


def pinhole() -> Values:
    mask = np.zeros(CAMERA.mask_shape, np.float32)
    mask[24:27, 10] = 1
    return mask


def test_masks_drawn_at_random_are_what_others_are_compared_with(meter: ConditioningMeter) -> None:
    drawn = np.random.default_rng(0).random((8, *CAMERA.mask_shape), np.float32)
    assert np.mean([meter.directions(mask) for mask in drawn]) == pytest.approx(1, abs=1e-9)


def test_mask_that_blurs_has_few_directions(meter: ConditioningMeter) -> None:
    for transmittance in (1.0, 0.5, 0.1):
        assert meter.directions(np.full(CAMERA.mask_shape, transmittance, np.float32)) < 0.5
    assert meter.directions(pinhole()) < 0.2
    assert meter.directions(np.zeros(CAMERA.mask_shape, np.float32)) == 0


def test_directions_are_singular_values(meter: ConditioningMeter) -> None:
    transfer = TransferOperator(CAMERA, Scene(), Embedding(12, 16))

    def count(mask: Values) -> int:
        matrix = transfer(torch.from_numpy(mask)).double()
        values = torch.linalg.svdvals(matrix - matrix.mean(0))
        return int((values > 0.01 * values[0]).sum())

    other = np.random.default_rng(9).random(CAMERA.mask_shape, np.float32)
    ratio = meter.directions(pinhole()) / meter.directions(other)
    assert ratio == pytest.approx(count(pinhole()) / count(other), rel=1e-9)


def test_finer_embedding_is_measured_as_the_finest() -> None:
    one, other, coarse = (
        ConditioningMeter(CAMERA, Scene(), embedding).directions(pinhole())
        for embedding in (Embedding(12, 16), Embedding(24, 32), Embedding(6, 8))
    )
    assert one == other != coarse


def test_mask_of_another_window_is_refused(meter: ConditioningMeter) -> None:
    with pytest.raises(OpticsError, match=r"weights\.shape"):
        meter.directions(np.ones(Camera(window=Window(9, 5)).mask_shape, np.float32))
