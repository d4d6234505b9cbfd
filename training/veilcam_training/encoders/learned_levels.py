"""A distribution of masks that is learned together with the classifier.

Small embeddings tell little apart behind a mask drawn uniformly. What is learned here is not a mask
but where the secret may draw: for every sub-pixel a range of numbers, at most ``spread`` to both
sides of a centre. The ranges are public; each mask is drawn within them, is used and forgotten.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.camera.masks import quantise
from veilcam_optics.keys.masks import MaskDistribution


class LearnedRange(nn.Module):
    """Ranges of ``u`` in [0, 1], one for each sub-pixel; the panel shows ``u ** exponent``.

    Args:
        camera: window and panel.
        exponent: of the curve.
        spread: half the length of a range, in (0, 1]; ranges end at 0 and 1.
        generator: draws the first centres, near 1/2.
    """

    def __init__(
        self, camera: Camera, exponent: float, spread: float, generator: torch.Generator
    ) -> None:
        super().__init__()
        self.camera, self.exponent, self.spread = camera, exponent, spread
        noise = torch.randn(camera.mask_shape, generator=generator)
        self.centre = nn.Parameter(0.5 + 0.02 * noise)

    def forward(self, generator: torch.Generator) -> Tensor:
        """One mask's weights, ``camera.mask_shape``, differentiable in the centres."""
        low, high = self._ends()
        drawn = low + (high - low) * torch.rand(low.shape, generator=generator)
        # Not quite 0: a power's slope there is 0, or infinite below an exponent of 1.
        return quantise(drawn.clamp_min(1e-4) ** self.exponent, self.camera.panel)

    def project(self) -> None:
        """Bring the centres back into [0, 1]."""
        with torch.no_grad():
            self.centre.clamp_(0, 1)

    def distribution(self) -> MaskDistribution:
        """The distribution to publish, in whole levels."""
        top = self.camera.panel.levels - 1
        low, high = (
            (end.detach() * top).round().to(torch.uint8).numpy().astype(np.uint8)
            for end in self._ends()
        )
        curve = MaskDistribution.power(self.camera, self.exponent).curve
        return MaskDistribution(low, high, curve)

    def _ends(self) -> tuple[Tensor, Tensor]:
        return (self.centre - self.spread).clamp_min(0), (self.centre + self.spread).clamp_max(1)
