"""What a converter makes of an error of the light that it rounds."""

import math

from torch import Tensor

from veilcam_optics.camera.imperfections import Conditions
from veilcam_optics.effects.sensor import converter_range

_ALIKE = 0.25
"""Standard deviation of codes that all lie about as far from where the next one begins."""


_SELDOM = 0.03
"""Of so few readings one holds a changed code: what that adds is left out."""


def converted(error: float, values: Tensor, conditions: Conditions, pixels: int) -> float:
    """Relative L2 of what is read, of an error of the light: equation (13).

    Two values that are ``e`` of a step apart are rounded to different codes in ``e`` of all cases,
    and are a whole step apart then: a small error of faint light grows.

    Args:
        error: relative L2 of the light.
        values: noiseless embeddings of a white scene.
        conditions: with a converter.
        pixels: values in a reading.
    """
    step = converter_range(conditions) / (2**conditions.adc_bits - 1)
    size = float(values.square().mean().sqrt())
    if not size:
        return error
    off = error * size / step
    if conditions.full_well:
        values = values.clamp_max(conditions.full_well / conditions.electrons)
    codes = ((values + conditions.black_level) / step).clamp_max(2**conditions.adc_bits - 1)
    if float(codes.std(correction=0)) > _ALIKE:
        changed = math.sqrt(2 / math.pi) * off  # the mean size of a normal error
    else:
        away = float((codes % 1 - 0.5).abs().min())
        changed = math.erfc(away / (math.sqrt(2) * off))
    if changed * pixels < _SELDOM:
        return error
    return math.hypot(error, step / size * math.sqrt(min(1.0, changed)))
