"""Noise on a reading, added after the optics."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from veilcam_optics.errors import invalid

DARK = 1e-6
"""Share of an image's brightest value below which the noise's amplitude has no gradient."""


def shot_noise(values: Tensor, snr_db: float, generator: torch.Generator | None = None) -> Tensor:
    """Add signal-dependent noise so that every image has the signal-to-noise ratio asked for.

    The variance is proportional to the value, as for photon counts, with the count per unit chosen
    per image so that ``10 log10(sum v^2 / sum E[n^2])`` is ``snr_db``. The normal approximation to
    the Poisson law is used, so gradients pass (at 40 dB a reading holds thousands of photons).
    They pass through the noise's amplitude too: a mask that is learned must know that light which
    tells nothing apart brings noise with it.

    Args:
        values: non-negative readings, shape (..., rows, columns) or (batch, pixels); the ratio
            holds over all axes but the first.
        snr_db: signal-to-noise ratio [dB]; ``math.inf`` adds nothing.
        generator: source of the random numbers, on the device of ``values``.

    Returns:
        Noisy readings, same shape and dtype. An image without light has no signal and stays as
        it is; so does an empty batch.

    Raises:
        OpticsError: ``snr_db`` is NaN or minus infinity.
    """
    if math.isnan(snr_db) or snr_db == -math.inf:
        raise invalid("snr_db", snr_db, "dB", "a finite number, or inf for no noise")
    if snr_db == math.inf or values.numel() == 0:
        return values
    axes = tuple(range(1, values.ndim)) or (0,)
    tiny = torch.finfo(values.dtype).tiny
    # In units of the peak, so that no product of values overflows or vanishes in float32. It
    # cancels, so it may count as a constant for the gradient.
    signal = values.clamp_min(0)
    peak = signal.detach().amax(axes, keepdim=True).clamp_min(tiny)
    share = signal / peak
    total = share.sum(axes, keepdim=True)
    # sum E[n^2] = total / photons, so photons = ratio * total / energy.
    energy = share.square().sum(axes, keepdim=True)
    per_light = energy / (total.clamp_min(tiny) * 10 ** (snr_db / 10))
    # Next to darkness a root has no gradient that is of use.
    root = torch.where(share > DARK, share.clamp_min(DARK).sqrt(), share.detach().sqrt())
    amplitude = peak * root * per_light.clamp_min(tiny).sqrt()
    noise = torch.randn(values.shape, generator=generator, dtype=values.dtype, device=values.device)
    return values + amplitude * noise
