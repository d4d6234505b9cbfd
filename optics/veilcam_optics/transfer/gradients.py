"""Derivatives that torch is told, of functions that are computed alike in NumPy."""

from typing import Any

import torch
from torch import Tensor

from veilcam_optics.transfer.fresnel_integrals import fresnel_integrals
from veilcam_optics.transfer.joining import joined


class FresnelIntegrals(torch.autograd.Function):
    """C(t) and S(t), with their exact derivatives."""

    @staticmethod
    def forward(ctx: Any, t: Tensor) -> tuple[Tensor, Tensor]:
        """Both integrals."""
        ctx.save_for_backward(t)
        return fresnel_integrals(t.detach())

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        """Return the part that both gradients share, with respect to ``t``."""
        (t,) = ctx.saved_tensors
        phase = torch.pi / 2 * t * t
        return gradients[0] * torch.cos(phase) + gradients[1] * torch.sin(phase)


class Joined(torch.autograd.Function):
    """Tensors one after another, as :func:`joined` puts them: first their length, all together."""

    @staticmethod
    def forward(ctx: Any, length: int, *parts: Tensor) -> Tensor:
        """All of them."""
        ctx.lengths = [len(part) for part in parts]
        return joined((part.detach() for part in parts), length)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradient of each part."""
        return None, *torch.split(gradients[0], ctx.lengths)
