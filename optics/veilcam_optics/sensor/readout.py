"""The sensor's way from irradiance to numbers: Bayer filter, counted photons, converter."""

import math

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Sensor

FULL_WELL = 8180
"""Electrons that a pixel of the IMX477 holds at gain 1, measured on a Raspberry Pi HQ camera:
strollswithmydog.com/pi-hq-cam-sensor-performance."""

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


def photon_snr_db(camera: Camera, embedding: Embedding, *, colour: bool = False) -> float:
    """Return the signal-to-noise ratio of an embedding value at full well, by photons alone [dB].

    A value counts N electrons, the pixels of its box times :data:`FULL_WELL`, with the standard
    deviation sqrt(N). So the ratio is 10 log10 N, as :func:`.noise.shot_noise` defines it.

    Args:
        camera: camera whose sensor pixels are counted.
        embedding: embedding with its fill.
        colour: True for a red or a blue value, to which a quarter of the pixels count.
    """
    height, width = embedding.box(camera.sensor)
    pixels = height * width / camera.sensor.pixel**2
    return 10 * math.log10(pixels * FULL_WELL * (0.25 if colour else 1.0))


def bayer_shares(sensor: Sensor, embedding: Embedding) -> Tensor:
    """Share of R, G and B in each embedding value of an RGGB sensor, float64 (3, rows, columns).

    A box that is not a whole even number of sensor pixels wide holds more of one
    colour than of another.
    """
    y = _parities(sensor.rows, embedding.rows, embedding.fill)
    x = _parities(sensor.columns, embedding.columns, embedding.fill)
    red = y[:, 0, None] * x[:, 0]
    blue = y[:, 1, None] * x[:, 1]
    return torch.stack([red, 1 - red - blue, blue])


def _parities(pixels: int, parts: int, fill: float) -> Tensor:
    """Share of even and of odd sensor pixels in the middle of ``parts`` equal parts: (parts, 2)."""
    middles = (torch.arange(parts, dtype=torch.float64)[:, None] + 0.5) * (pixels / parts)
    edges = middles + torch.tensor([-0.5, 0.5], dtype=torch.float64) * (fill * pixels / parts)
    # Length of even pixels below a position: one of each pair, and the rest's first half.
    even = torch.floor(edges / 2) + torch.remainder(edges, 2).clamp_max(1)
    share = (even.diff() / edges.diff())[:, 0]
    return torch.stack([share, 1 - share], dim=1)
