"""Random masks and bare panels for tests of optics, and how far two results are apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Panel, Scene
from veilcam_optics.plan import Plan
from veilcam_optics.simulation.operator import LightOperator


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def mask(camera: Camera, seed: int = 0) -> Tensor:
    return torch.rand(camera.mask_shape, generator=seeded(seed), dtype=torch.float64)


def smooth_scenes(scene: Scene, count: int, seed: int) -> Tensor:
    """Sums of a few random blobs, in [0, 1]."""
    generator = seeded(seed)
    size = torch.tensor(scene.shape)
    centres = size * torch.rand(count, 3, 2, generator=generator)
    y = torch.exp(-((torch.arange(scene.rows) + 0.5 - centres[..., :1]) ** 2) / 3)
    x = torch.exp(-((torch.arange(scene.columns) + 0.5 - centres[..., 1:]) ** 2) / 3)
    return (y[..., :, None] * x[..., None, :]).sum(1).clamp(0, 1)


def bare(pitch: float, aperture: float) -> Panel:
    return Panel(
        pitch_y=pitch, pitch_x=pitch, aperture_y=aperture, aperture_x=aperture, filter_cycle=()
    )


def axial(chosen: Plan) -> LightOperator:
    """What a plan computes, without the angle of the field, as the reference knows no other."""
    sampling = replace(chosen.model.sampling, oblique=False, zones=1)
    return LightOperator(replace(chosen.model, sampling=sampling))


def relative(value: Tensor, reference: Tensor | np.ndarray) -> float:
    reference = torch.as_tensor(reference)
    return float((value - reference).norm() / reference.norm())


def assert_same(value: Tensor, reference: Tensor) -> None:
    # Sums in float64 of fewer than 1000 terms, in any order: 1000 units of 1.1e-16, ten times over;
    # entries that far below the largest, 1e-2, are sums of terms that cancel.
    torch.testing.assert_close(value, reference, rtol=1e-12, atol=1e-14)
