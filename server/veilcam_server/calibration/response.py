"""Response of panel and sensor to the staircase of levels, fitted by least squares."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from veilcam_server.calibration.rig import Rig, Values
from veilcam_server.errors import CalibrationError

_BEGIN, _FACTOR = 1e-3, 10.0
"""First damping, and the factor of its changes."""


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
        start: first values, (N,); those out of bounds begin at the bound.
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


STEPS = 16
"""Number of levels of the staircase."""
_MISFIT = 0.03
"""Largest residual, over the light of the open panel."""


@dataclass(frozen=True, slots=True)
class Staircase:
    """Mean measurements of uniform levels, without the black level."""

    weights: Values = field(repr=False)
    """Levels over the highest one."""
    light: Values = field(repr=False)


@dataclass(frozen=True, slots=True)
class Response:
    """Amplitude ``floor + (1 - floor) w^gamma``; each with its standard uncertainty."""

    gamma: float
    gamma_uncertainty: float
    floor: float
    floor_uncertainty: float
    scale: float
    """Light of the open panel."""
    residual: float
    """Root mean square, over that light."""

    def light(self, weights: Values) -> Values:
        """Return the prediction of the fit."""
        return _light(weights, self.scale, self.gamma, self.floor)


def climb(rig: Rig, *, black_level: float) -> Staircase:
    """Measure all steps in random order, so that slow drift does not bend the curve."""
    top = int(np.max(rig.open))
    levels = np.unique(np.linspace(0, top, STEPS).round().astype(int))
    light = np.zeros(len(levels))
    for index in np.random.default_rng(0).permutation(len(levels)):
        light[index] = rig.read(rig.uniform(int(levels[index]))).mean() - black_level
    return Staircase(levels / top, light)


def fit_response(
    staircase: Staircase, *, floor: float | None = None, floor_uncertainty: float = 0.0
) -> Response:
    """Fit gamma, floor and scale.

    Args:
        staircase: measurements of a panel that shows the same level everywhere.
        floor: contrast floor that is known already, as on a panel with dead lines. Dead lines add
            light to every level, so only the light above the lowest step is fitted then.
        floor_uncertainty: uncertainty of that floor.

    Raises:
        CalibrationError: the panel's response is no power law.
    """
    weights, light = staircase.weights, staircase.light
    top = float(np.max(light))
    if not top > 0:
        raise CalibrationError("no light comes through the open panel: light the card, try again")
    offset = 0.0 if floor is None else light[0]

    def residuals(values: Values) -> Values:
        scale, gamma, level = (*values, floor)[:3]
        expected = _light(weights, scale, gamma, level)
        if floor is not None:
            expected = expected - scale * floor**2
        return expected - (light - offset) / top

    def jacobian(values: Values) -> Values:
        scale, gamma, level = (*values, floor)[:3]
        expected = _light(weights, scale, gamma, level)
        shown = weights**gamma
        amplitude = level + (1 - level) * shown
        # The power has no slope at level 0.
        slope = shown * np.log(np.where(weights > 0, weights, 1.0))
        columns = [expected / scale, 2 * scale * amplitude * (1 - level) * slope]
        if floor is None:
            columns.append(2 * scale * amplitude * (1 - shown))
        else:
            columns[0] = columns[0] - floor**2
        return np.stack(columns, axis=1)

    start, lowest, highest = [1.0, 1.0], [0.01, 0.1], [4.0, 10.0]
    if floor is None:
        start.append(float(np.sqrt(np.clip(light[0] / top, 1e-6, 0.9))))
        lowest.append(0.0)
        highest.append(0.99)
    found = least_squares(
        residuals,
        jacobian,
        np.array(start),
        lowest=np.array(lowest),
        highest=np.array(highest),
    )
    rms = float(np.sqrt(np.mean(found.residuals**2)))
    if rms > _MISFIT:
        raise CalibrationError(
            f"the panel's response is no power law (residual {100 * rms:.2g} %): check that the "
            "light is steady, and the panel's settings"
        )
    spread = uncertainties(found.jacobian, found.residuals)
    return Response(
        gamma=float(found.values[1]),
        gamma_uncertainty=float(spread[1]),
        floor=float(found.values[2]) if floor is None else floor,
        floor_uncertainty=float(spread[2]) if floor is None else floor_uncertainty,
        scale=float(found.values[0]) * top,
        residual=rms,
    )


def uncertainties(jacobian: Values, residuals: Values) -> Values:
    """Return the standard uncertainties of a least-squares fit, with its residual as noise."""
    freedom = max(1, len(residuals) - jacobian.shape[1])
    variance = float(np.sum(residuals**2)) / freedom
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * variance
    return np.sqrt(np.diag(covariance))


def _light(weights: Values, scale: float, gamma: float, floor: float) -> Values:
    """Return the light through sub-pixels that all show one amplitude: its square."""
    return scale * (floor + (1 - floor) * weights**gamma) ** 2
