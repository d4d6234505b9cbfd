"""What the conditioning of a transfer matrix says of masks."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import torch

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Window
from veilcam_optics.errors import OpticsError
from veilcam_optics.transfer.conditioning import Conditioning, ConditioningMeter
from veilcam_optics.transfer.operator import TransferOperator

CAMERA = Camera()


@pytest.fixture(scope="module")
def meter() -> ConditioningMeter:
    return ConditioningMeter(CAMERA, Scene(), Embedding(12, 16))


Values = npt.NDArray[np.float32]


def pinhole() -> Values:
    mask = np.zeros(CAMERA.mask_shape, np.float32)
    mask[24:27, 10] = 1
    return mask


def test_masks_drawn_at_random_are_what_others_are_compared_with(meter: ConditioningMeter) -> None:
    drawn = np.random.default_rng(0).random((8, *CAMERA.mask_shape), np.float32)
    found = [meter(mask) for mask in drawn]
    for name in ("directions", "spread", "own"):
        shares = [getattr(each, name) for each in found]
        assert sum(shares) / len(shares) == pytest.approx(1, abs=1e-9)


def test_open_window_has_nothing_of_its_own_however_dark(meter: ConditioningMeter) -> None:
    for transmittance in (1.0, 0.5, 0.1):
        found = meter(np.full(CAMERA.mask_shape, transmittance, np.float32))
        assert found.own < 1e-9
        assert found.directions < 0.5
    assert meter(np.zeros(CAMERA.mask_shape, np.float32)) == Conditioning(0, 0, 0)


def test_hole_sees_one_place_from_each_pixel(meter: ConditioningMeter) -> None:
    found = meter(pinhole())
    # Its own is nearly all there is, and random masks have 7 % of their own.
    assert found.own > 10
    assert found.spread < 0.03
    assert found.directions < 0.2


def test_directions_are_singular_values(meter: ConditioningMeter) -> None:
    transfer = TransferOperator(CAMERA, Scene(), Embedding(12, 16))

    def count(mask: Values) -> int:
        matrix = transfer(torch.from_numpy(mask)).double()
        values = torch.linalg.svdvals(matrix - matrix.mean(0))
        return int((values > 0.01 * values[0]).sum())

    other = np.random.default_rng(9).random(CAMERA.mask_shape, np.float32)
    ratio = meter(pinhole()).directions / meter(other).directions
    assert ratio == pytest.approx(count(pinhole()) / count(other), rel=1e-9)


def test_finer_embedding_is_measured_as_the_finest() -> None:
    one, other = (
        ConditioningMeter(CAMERA, Scene(), embedding)(pinhole())
        for embedding in (Embedding(12, 16), Embedding(24, 32))
    )
    assert one == other
    assert ConditioningMeter(CAMERA, Scene(), Embedding(6, 8))(pinhole()) != one


def test_mask_of_another_window_is_refused(meter: ConditioningMeter) -> None:
    with pytest.raises(OpticsError, match=r"weights\.shape"):
        meter(np.ones(Camera(window=Window(9, 5)).mask_shape, np.float32))
