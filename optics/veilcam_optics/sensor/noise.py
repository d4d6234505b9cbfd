"""Noise on a measurement, added after the optics."""

import math
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from veilcam_optics.errors import require_ratio

DARK = 1e-6
"""Share of an image's brightest value up to which the noise's amplitude loses its gradient."""


def shot_noise(values: Tensor, snr_db: float, generator: torch.Generator | None = None) -> Tensor:
    """Add signal-dependent noise so that every image has the signal-to-noise ratio asked for.

    The variance is proportional to the value, as for photon counts, with the count per unit chosen
    per image so that ``10 log10(sum v^2 / sum E[n^2])`` is ``snr_db``. The normal approximation to
    the Poisson law is used, so gradients pass (at 40 dB a measurement holds thousands of photons).
    They pass through the noise's amplitude too: a mask that is learned must know that light which
    tells nothing apart brings noise with it.

    Args:
        values: non-negative measurements, shape (..., rows, columns) or (batch, pixels); the ratio
            holds over all axes but the first.
        snr_db: signal-to-noise ratio [dB]; ``math.inf`` adds nothing.
        generator: source of the random numbers, on the device of ``values``.

    Returns:
        Noisy measurements, same shape and dtype. An image without light has no signal and stays as
        it is; so does an empty batch.

    Raises:
        OpticsError: ``snr_db`` is NaN or minus infinity.
    """
    require_ratio("snr_db", snr_db)
    if snr_db == math.inf or values.numel() == 0:
        return values
    noise = torch.randn(values.shape, generator=generator, dtype=values.dtype, device=values.device)
    noisy: Tensor = _Noisy.apply(values, noise, 10 ** (snr_db / 10))  # type: ignore[no-untyped-call]
    return noisy


class _Noisy(torch.autograd.Function):
    """``values + amplitude(values) noise`` and its gradient in closed form.

    A training step is short enough for the dozen large intermediates of the plain formula, and of
    what autograd makes of it, to count in it.
    """

    @staticmethod
    def forward(ctx: Any, values: Tensor, noise: Tensor, ratio: float) -> Tensor:
        """Return the noisy values."""
        axes = tuple(range(1, values.ndim)) or (0,)
        tiny = torch.finfo(values.dtype).tiny
        # In units of the peak, so that no product of values overflows or vanishes in float32. It
        # cancels, so it may count as a constant for the gradient.
        signal = values.clamp_min(0)
        peak = signal.amax(axes, keepdim=True).clamp_min_(tiny)
        share = signal.div_(peak)
        total = share.sum(axes, keepdim=True).clamp_min_(tiny)
        energy = share.square().sum(axes, keepdim=True)
        # sum E[n^2] = total / photons, so photons = ratio * total / energy.
        per_light = (energy / (total * ratio)).clamp_min_(tiny).sqrt_()
        unit = share.sqrt().mul_(noise)
        ctx.save_for_backward(unit, share, total, energy, per_light)
        ctx.ratio = ratio
        return torch.addcmul(values, unit, peak * per_light)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        """Return the gradient with respect to the values, all of which count as lit."""
        unit, share, total, energy, per_light = ctx.saved_tensors
        pulled = gradient * unit
        # Through the photons per light, which all light of an image shares. A dark image has none.
        axes = tuple(range(1, share.ndim)) or (0,)
        shared = pulled.sum(axes, keepdim=True)
        tiny = torch.finfo(share.dtype).tiny
        shared = shared / (2 * ctx.ratio * per_light * total.square()).clamp_min(tiny)
        # Through the root of the light; next to darkness that has no gradient that is of use.
        found = torch.addcmul(gradient, pulled.div_(share + DARK), per_light / 2)
        found = found.addcmul_(share, 2 * shared * total).sub_(shared * energy)
        return found, None, None
