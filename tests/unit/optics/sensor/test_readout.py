"""Colours by exact shares, and counted photons."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Embedding, Sensor
from veilcam_optics.sensor.readout import bayer_shares, counted


def mosaic(planes: Tensor) -> Tensor:
    """What an RGGB sensor sees of (3, rows, columns): one colour at every pixel."""
    seen = planes[1].clone()
    seen[0::2, 0::2] = planes[0, 0::2, 0::2]
    seen[1::2, 1::2] = planes[2, 1::2, 1::2]
    return seen


@pytest.mark.parametrize("shape", [(1, 1), (3, 4), (7, 5), (13, 10)])
def test_bayer_shares_are_those_of_a_mosaic(shape: tuple[int, int]) -> None:
    """Averages over embedding pixels, cut where sensor pixels are cut, of what a mosaic sees."""
    sensor = Sensor(rows=13, columns=10)
    shares = bayer_shares(sensor, Embedding(*shape))

    def cover(pixels: int, parts: int) -> Tensor:
        edges = torch.arange(parts + 1, dtype=torch.float64) * pixels / parts
        index = torch.arange(pixels, dtype=torch.float64)
        upper = torch.minimum(edges[1:, None], index + 1)
        lower = torch.maximum(edges[:-1, None], index)
        return (upper - lower).clamp_min(0) * parts / pixels

    for channel in range(3):
        planes = torch.zeros(3, 13, 10, dtype=torch.float64)
        planes[channel] = 1
        seen = cover(13, shape[0]) @ mosaic(planes) @ cover(10, shape[1]).T
        assert torch.allclose(shares[channel], seen)


def test_one_photon_in_a_hundred_pixels() -> None:
    faint = counted(torch.full((300, 300), 0.01), torch.Generator().manual_seed(0))
    # 90000 pixels: a tenth is three standard deviations of the number of lit ones.
    assert float((faint > 0).double().mean()) == pytest.approx(1 - math.exp(-0.01), rel=0.1)
