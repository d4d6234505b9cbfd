"""The sensor's way from irradiance to numbers: Bayer filter, counted photons, converter."""

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Embedding, Sensor

_MOST_COUNTED = 1e15
"""Electrons whose noise stands for that of any more: a count beyond 2^63 wraps around."""


def counted(electrons: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Whole photo-electrons as they arrive at random (Poisson), with the gradient of their mean.

    Args:
        electrons: expected number, any shape; what is negative counts as none.
        generator: source of the random numbers.
    """
    expected = electrons.detach().clamp(0, _MOST_COUNTED)
    whole: Tensor = torch.poisson(expected, generator=generator)
    return electrons + (whole - expected)


def digitised(values: Tensor, bits: int, ends: float) -> Tensor:
    """Values rounded to the steps of a converter of ``bits`` bits from 0 to ``ends``, clipped.

    The gradient is that of the identity.
    """
    most = (1 << bits) - 1
    step = ends / most
    counts = (values.detach() / step).round().clamp(0, most)
    return values + (counts * step - values.detach())


def bayer_shares(sensor: Sensor, embedding: Embedding) -> Tensor:
    """Share of R, G and B in each embedding pixel of an RGGB sensor, float64 (3, rows, columns).

    An embedding pixel that is not a whole even number of sensor pixels wide holds more of one
    colour than of another.
    """
    y = _parities(sensor.rows, embedding.rows)
    x = _parities(sensor.columns, embedding.columns)
    red = y[:, 0, None] * x[:, 0]
    blue = y[:, 1, None] * x[:, 1]
    return torch.stack([red, 1 - red - blue, blue])


def _parities(pixels: int, parts: int) -> Tensor:
    """Share of even and of odd sensor pixels in each of ``parts`` equal parts: (parts, 2)."""
    edges = torch.arange(parts + 1, dtype=torch.float64) * (pixels / parts)
    # Length of even pixels below a position: one of each pair, and the rest's first half.
    even = torch.floor(edges / 2) + torch.remainder(edges, 2).clamp_max(1)
    share = even.diff() / edges.diff()
    return torch.stack([share, 1 - share], dim=1)
