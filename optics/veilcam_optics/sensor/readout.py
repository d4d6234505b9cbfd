"""From irradiance to what the camera reads: photons, electrons, numbers."""

from __future__ import annotations

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Embedding, Sensor
from veilcam_optics.camera.imperfections import Conditions
from veilcam_optics.sensor.noise import shot_noise

_MOST_COUNTED = 1e15
"""Electrons whose noise stands for that of any more: a count beyond 2^63 wraps around."""


def read(
    values: Tensor,
    conditions: Conditions,
    *,
    shot: bool = True,
    generator: torch.Generator | None = None,
) -> Tensor:
    """What the camera reads of noiseless embeddings.

    Counting and rounding pass the gradient of the identity on (straight-through).

    Args:
        values: noiseless embeddings, (batch, ...), not negative.
        conditions: noise, saturation, converter and offset.
        shot: False leaves the photon noise out.
        generator: source of the random numbers.

    Returns:
        Readings in the unit of ``values``, same shape.
    """
    if shot:
        values = shot_noise(values, conditions.snr_db, generator)
    if conditions.electrons:
        electrons = values * conditions.electrons
        if shot:
            expected = electrons.detach().clamp(0, _MOST_COUNTED)
            counted = torch.poisson(expected, generator=generator)
            electrons = electrons + (counted - expected)
        if conditions.read_noise:
            noise = torch.randn(
                electrons.shape, generator=generator, dtype=values.dtype, device=values.device
            )
            electrons = electrons + conditions.read_noise * noise
        if conditions.full_well:
            electrons = electrons.clamp_max(conditions.full_well)
        values = electrons / conditions.electrons
    values = values + conditions.black_level
    if conditions.adc_bits:
        step = converter_range(conditions) / (2**conditions.adc_bits - 1)
        counts = (values.detach() / step).round().clamp(0, 2**conditions.adc_bits - 1)
        values = values + (counts * step - values.detach())
    return values


def converter_range(conditions: Conditions) -> float:
    """Embedding value at which the converter ends."""
    if conditions.adc_range:
        return conditions.adc_range
    if conditions.full_well:
        return conditions.full_well / conditions.electrons
    return 1.0


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
