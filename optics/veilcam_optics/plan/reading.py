"""Error of a reading: a converter rounds the error of the light."""

import math

import torch
from torch import Tensor

from veilcam_optics.camera.imperfections import Conditions
from veilcam_optics.effects.sensor import converter_range

_ALIKE = 0.25
"""Standard deviation of codes that all lie about as far from where the next one begins."""

_SELDOM = 0.01
"""Of so few readings one holds a changed code: what that adds is left out, since a prediction is to
hold in ninety-nine cases of a hundred."""

_AT_ONCE = 0.5
"""Of a code that changes, squared: twice the prediction then holds two of them, or one where a mask
passes less light than others."""


def converted(error: float, values: Tensor, conditions: Conditions, pixels: int) -> float:
    """Relative L2 of what is read, of an error of the light: equation (13).

    Two values that are ``e`` of a step apart are rounded to different codes in ``e`` of all cases,
    and are a whole step apart then: a small error of faint light grows. What is below half a step
    has nothing to fall to: it changes if the error lifts it above.

    Codes are whole: of a reading none is changed, or one at least, or all where all are alike. What
    changes in few readings is little as a mean over them, and much where it does: a prediction is
    to hold there, too.

    Args:
        error: relative L2 of the light.
        values: noiseless embeddings of a white scene, (masks, rows, columns).
        conditions: conditions with a converter.
        pixels: values in a reading.
    """
    step = converter_range(conditions) / (2**conditions.adc_bits - 1)
    sizes = values.square().mean((-2, -1), keepdim=True).sqrt()
    lit = sizes.flatten() > 0
    if not lit.any():
        return error
    values, sizes = values[lit], sizes[lit]
    off = error * sizes / step
    if conditions.full_well:
        values = values.clamp_max(conditions.full_well / conditions.electrons)
    codes = ((values + conditions.black_level) / step).clamp_max(2**conditions.adc_bits - 1)
    if float(codes.std(correction=0)) > _ALIKE:
        changed = (math.sqrt(2 / math.pi) * off).expand_as(codes)  # the mean size of a normal error
        lifted = torch.erfc((0.5 - codes) / (math.sqrt(2) * off)) / 2
        changed = torch.where(codes < 0.5, torch.minimum(lifted, changed), changed)
        least = 1 / pixels
    else:
        away = (codes % 1 - 0.5).abs().amin()
        changed = torch.erfc(away / (math.sqrt(2) * off))
        least = 1.0
    shares = changed.clamp_max(1).expand_as(codes).mean((-2, -1))
    if float(shares.mean()) * pixels < _SELDOM:
        return error
    seen = shares * pixels >= _SELDOM
    shares = torch.where(seen, shares.clamp_min(_AT_ONCE * least), shares)
    return math.hypot(error, float((shares * (step / sizes.flatten()).square()).mean().sqrt()))
