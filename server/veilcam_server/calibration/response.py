"""Response of the panel to levels: gamma and contrast floor, from a staircase of levels."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from veilcam_server.calibration.least_squares import least_squares
from veilcam_server.calibration.rig import Rig, Values
from veilcam_server.errors import CalibrationError

STEPS = 16
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
    """Read all steps, in an order that keeps a slow drift out of the curve."""
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
        floor: contrast floor where it is known otherwise, as on a panel with dead lines. Their
            light is there at every level: then only the light above the lowest step is fitted.
        floor_uncertainty: uncertainty of that.

    Raises:
        CalibrationError: the panel's response is another one.
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
        # Of level 0, the power has no slope.
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
    """Return the standard uncertainties of a least-squares fit, its residual taken for noise."""
    freedom = max(1, len(residuals) - jacobian.shape[1])
    variance = float(np.sum(residuals**2)) / freedom
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * variance
    return np.sqrt(np.diag(covariance))


def _light(weights: Values, scale: float, gamma: float, floor: float) -> Values:
    """Sub-pixels that all show one amplitude let its square through."""
    return scale * (floor + (1 - floor) * weights**gamma) ** 2
