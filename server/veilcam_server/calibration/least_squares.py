"""Non-linear least squares between bounds, in NumPy: a device has no SciPy.

Marquardt's damping (J. SIAM 11, 1963, 431-441), scaled by the columns of the Jacobian. A value that
is at a bound, and would leave it, rests for a step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from veilcam_server.calibration.rig import Values

_BEGIN, _FACTOR = 1e-3, 10.0
"""Damping at first, and what it changes by."""


@dataclass(frozen=True, eq=False, slots=True)
class Fit:
    """Minimum of the squares, with residuals and Jacobian there."""

    values: Values
    residuals: Values
    jacobian: Values


def least_squares(
    residuals: Callable[[Values], Values],
    jacobian: Callable[[Values], Values],
    start: Values,
    *,
    lowest: float | Values = -math.inf,
    highest: float | Values = math.inf,
    tolerance: float = 1e-8,
    evaluations: int = 100,
) -> Fit:
    """Find the values whose residuals have the least squares, near ``start``.

    Args:
        residuals: function of values (N,) that gives residuals (M,).
        jacobian: their derivatives, (M, N).
        start: (N,); what is out of bounds begins at the bound.
        lowest: lower bound of each value.
        highest: upper bound of each value.
        tolerance: smallest share by which a step has to lower the squares; the fit ends below it.
        evaluations: greatest number of evaluations of the residuals.
    """
    values = np.clip(start, lowest, highest)
    found = Fit(values, residuals(values), jacobian(values))
    damping = _BEGIN
    for _ in range(evaluations - 1):
        squares = _squares(found.residuals)
        tried = np.clip(found.values + _step(found, damping, lowest, highest), lowest, highest)
        if np.array_equal(tried, found.values):
            break
        left = residuals(tried)
        if _squares(left) < squares:
            found = Fit(tried, left, jacobian(tried))
            if squares - _squares(left) <= tolerance * squares:
                break
            damping /= _FACTOR
        else:
            damping *= _FACTOR
    return found


def _squares(residuals: Values) -> float:
    return float(residuals @ residuals)


def _step(found: Fit, damping: float, lowest: float | Values, highest: float | Values) -> Values:
    gradient = found.jacobian.T @ found.residuals
    leaving = np.where(gradient > 0, found.values <= lowest, found.values >= highest)
    free = ~leaving & (gradient != 0)
    columns = found.jacobian[:, free]
    curvature = columns.T @ columns
    step = np.zeros_like(found.values)
    scaled = curvature + damping * np.diag(np.diag(curvature))
    step[free] = np.linalg.lstsq(scaled, -gradient[free], rcond=None)[0]
    return step
