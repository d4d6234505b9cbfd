"""Light through an opaque panel is the floor's and that of dead lines: which is whose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.optimize import nnls

from veilcam_optics.decoding import Calibration
from veilcam_optics.transfer.operator import Reach
from veilcam_server.calibration.alignment import NAMES, Optics, Sight, strayed
from veilcam_server.calibration.geometry import Geometry
from veilcam_server.calibration.response import uncertainties


def split_darkness(
    geometry: Geometry,
    opaque: Sequence[Sight],
    gains: Sequence[float],
    calibration: Calibration,
    *,
    reach: Reach,
    stray: float = 0.0,
) -> tuple[Calibration, float, float]:
    """Contrast floor and transmittance of dead lines, from where an opaque panel's light falls.

    Args:
        geometry: the camera as drawn.
        opaque: scenes behind the opaque panel, one pattern each.
        gains: reading per predicted reading of those scenes.
        calibration: where the mask is, and which lines are dead.
        reach: which sub-pixels interfere.
        stray: share of the light that is spread evenly.

    Returns:
        The calibration with both, and their standard uncertainties.
    """
    ones = torch.ones(geometry.camera.mask_shape, dtype=torch.float64)
    plain = replace(calibration, gamma=1.0, contrast_floor=0.0, dead_transmittance=0.0)
    alive = plain.shown(ones)
    optics = Optics(
        geometry, torch.stack([alive, ones - alive]), [sight.image for sight in opaque], reach
    )
    place = torch.tensor([getattr(calibration, name) for name in NAMES], dtype=torch.float64)
    straight = optics.predict(place).reshape(len(opaque), 2, -1).numpy()
    predicted = strayed(straight, stray, geometry.embedding.size)
    columns, values = [], []
    for sight, gain, each in zip(opaque, gains, predicted, strict=True):
        # Not scaled to each other: what little comes of a lamp is below a step of the converter.
        columns.append(each.T * gain)
        values.append(sight.readings.ravel())
    matrix, seen = np.concatenate(columns), np.concatenate(values)
    # Amplitudes are the roots of what is fitted, and so are their uncertainties, to first order.
    shares, _ = nnls(matrix, seen)
    amplitudes = np.sqrt(shares)
    spread = uncertainties(matrix, matrix @ shares - seen)
    spread = np.minimum(spread / np.maximum(2 * amplitudes, 1e-9), np.sqrt(spread))
    found = replace(
        calibration,
        contrast_floor=min(float(amplitudes[0]), 0.99),
        dead_transmittance=min(float(amplitudes[1]), 1.0),
    )
    return found, float(spread[0]), float(spread[1])
