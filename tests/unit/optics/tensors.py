"""Random masks and bare panels for tests of optics, and how far two results are apart."""

from __future__ import annotations

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Panel


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def mask(camera: Camera, seed: int = 0) -> Tensor:
    return torch.rand(camera.mask_shape, generator=seeded(seed), dtype=torch.float64)


def bare(pitch: float, aperture: float) -> Panel:
    """A panel of square sub-pixels without filters."""
    return Panel(
        pitch_y=pitch, pitch_x=pitch, aperture_y=aperture, aperture_x=aperture, filter_cycle=()
    )


def relative(value: Tensor, reference: Tensor) -> float:
    return float((value - reference).norm() / reference.norm())


def assert_same(value: Tensor, reference: Tensor) -> None:
    """Equal but for rounding."""
    # Sums in float64 of fewer than 1000 terms, in any order: 1000 units of 1.1e-16, ten times over;
    # entries that far below the largest, 1e-2, are sums of terms that cancel.
    torch.testing.assert_close(value, reference, rtol=1e-12, atol=1e-14)
