"""From light to digital numbers: Bayer filter, shot and read noise, full well, converter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from veilcam_optics.errors import OpticsError, invalid, require_count, require_positive

RGGB = ((0, 1), (1, 2))
"""Channel (0 R, 1 G, 2 B) of every pixel in the repeating 2 x 2 block."""


@dataclass(frozen=True, slots=True)
class Readout:
    """One pixel's way from photo-electrons to a digital number.

    Attributes:
        full_well: Electrons at which a pixel, and the converter with it, saturates.
        read_noise: Standard deviation of the noise of reading [electrons].
        bit_depth: Of the converter.
        black_level: Digital number without light, so that noise below zero is not cut off.
        shot_noise: Whether electrons are counted (Poisson) or come as their mean.
    """

    full_well: float = 8000.0
    read_noise: float = 3.0
    bit_depth: int = 12
    black_level: int = 256
    shot_noise: bool = True

    def __post_init__(self) -> None:
        require_positive("full_well", self.full_well, "electrons")
        require_count("bit_depth", self.bit_depth)
        if not (math.isfinite(self.read_noise) and self.read_noise >= 0):
            raise invalid("read_noise", self.read_noise, "electrons", "a finite number >= 0")
        if not 0 <= self.black_level < self.white_level:
            raise invalid("black_level", self.black_level, "", f"0 to {self.white_level - 1}")

    @property
    def white_level(self) -> int:
        """Largest digital number."""
        return (1 << self.bit_depth) - 1

    @property
    def gain(self) -> float:
        """Digital numbers per electron: a full well just reaches the largest number."""
        return (self.white_level - self.black_level) / self.full_well

    def read(self, electrons: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Return the digital numbers of one exposure.

        Args:
            electrons: Mean number of photo-electrons per pixel, any shape.
            generator: Source of randomness; the global one if None.

        Returns:
            int32, same shape, 0 to ``white_level``.

        Raises:
            OpticsError: If a mean is negative or NaN.
        """
        mean = electrons.detach().double()
        if not bool((mean >= 0).all()):
            raise OpticsError("electrons holds negative numbers or NaN: use means >= 0")
        # Past the full well nothing more is counted; a mean of 10^18 must not overflow the draw.
        bounded = mean.clamp(max=self.full_well * 4 + 1000)
        counted = torch.poisson(bounded, generator=generator) if self.shot_noise else bounded
        held = counted.clamp(max=self.full_well)
        noise = torch.randn(held.shape, generator=generator, dtype=held.dtype, device=held.device)
        numbers = (held + self.read_noise * noise) * self.gain + self.black_level
        return numbers.round().clamp(0, self.white_level).to(torch.int32)

    def electrons(self, numbers: Tensor) -> Tensor:
        """Return the electrons that digital numbers stand for: black level off, gain undone."""
        return (numbers.double() - self.black_level) / self.gain

    def saturated(self, numbers: Tensor) -> Tensor:
        """Return which pixels gave the largest number: what they received is not known."""
        return numbers >= self.white_level


def mosaic(planes: Tensor, pattern: tuple[tuple[int, int], tuple[int, int]] = RGGB) -> Tensor:
    """Return what a Bayer sensor sees: one channel of (..., 3, rows, columns) at every pixel.

    Odd sizes are allowed; the pattern starts at the first row and column.

    Raises:
        OpticsError: If there are not three channels, or the pattern names another one.
    """
    if planes.ndim < 3 or planes.shape[-3] != 3:
        raise invalid("planes.shape", tuple(planes.shape), "", "(..., 3, rows, columns)")
    if any(channel not in (0, 1, 2) for line in pattern for channel in line):
        raise invalid("pattern", pattern, "", "two by two of 0 (R), 1 (G), 2 (B)")
    seen = torch.empty_like(planes[..., 0, :, :])
    for row, line in enumerate(pattern):
        for column, channel in enumerate(line):
            seen[..., row::2, column::2] = planes[..., channel, row::2, column::2]
    return seen


def split_mosaic(
    raw: Tensor, pattern: tuple[tuple[int, int], tuple[int, int]] = RGGB
) -> dict[int, list[Tensor]]:
    """Return the sub-images (..., rows / 2, columns / 2) of each channel, without interpolation."""
    planes: dict[int, list[Tensor]] = {}
    for row, line in enumerate(pattern):
        for column, channel in enumerate(line):
            planes.setdefault(channel, []).append(raw[..., row::2, column::2])
    return planes
