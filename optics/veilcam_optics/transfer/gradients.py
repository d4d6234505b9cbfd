"""Derivatives that torch is told, of functions that are computed alike in NumPy."""

from typing import Any

import torch
from torch import Tensor

from veilcam_optics.transfer.fresnel_integrals import fresnel_integrals


class FresnelIntegrals(torch.autograd.Function):
    """C(t) and S(t), with their exact derivatives."""

    @staticmethod
    def forward(ctx: Any, t: Tensor) -> tuple[Tensor, Tensor]:
        """Both integrals."""
        ctx.save_for_backward(t)
        return fresnel_integrals(t.detach())

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        """What both gradients come to with respect to ``t``."""
        (t,) = ctx.saved_tensors
        phase = torch.pi / 2 * t * t
        return gradients[0] * torch.cos(phase) + gradients[1] * torch.sin(phase)
