"""Alignment of the mask and share of stray light, fitted through the differentiable optics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from veilcam_optics.camera.imperfections import Imperfections
from veilcam_optics.transfer.tables import Reach, make_transfer
from veilcam_server.calibration.response import least_squares, uncertainties
from veilcam_server.calibration.rig import Geometry, Values

NAMES = ("shift_y", "shift_x", "rotation", "distance_error")
_UNITS = np.array([1e-6, 1e-6, 1e-3, 1e-5])
"""Units of the fitted numbers: um, um, mrad, 10 um."""
_PERCENT = 1e-2
"""Unit in which the fit moves the share of stray light."""
_STEP = 6.2e-6
"""Distance of integration nodes [m]: four times the operator's own, which changes the shift found
by less than 0.1 um."""
_EVALUATIONS = 12
_SMALL = 0.03
"""Step of differences, in units of the fit."""


@dataclass(frozen=True, eq=False, slots=True)
class SceneReadings:
    """Measurements of one known scene behind several patterns."""

    image: Values = field(repr=False)
    """(rows, columns) of the scene."""
    measurements: Values = field(repr=False)
    """(patterns, rows, columns) of the embedding, without the black level."""

    @property
    def scale(self) -> float:
        """Root mean square of the measurements."""
        return float(np.sqrt(np.mean(self.measurements**2)))


@dataclass(frozen=True, slots=True)
class Alignment:
    """The fit; uncertainties are standard ones, in the order of :data:`NAMES`."""

    imperfections: Imperfections
    uncertainties: tuple[float, float, float, float]
    gains: tuple[float, ...]
    """Measurement per predicted measurement, for each scene."""
    gain_uncertainties: tuple[float, ...]
    stray_uncertainty: float
    """Standard uncertainty of the share of light that is spread evenly."""
    residuals: tuple[float, ...]
    """Root mean square of each scene, relative to its measurements."""


class Optics:
    """Predicted measurements as a function of the mask's place; float64.

    Args:
        geometry: the nominal camera.
        weights: (patterns, rows, columns), amplitudes as the panel shows them.
        images: known scenes.
        reach: reach of interference between sub-pixels.
    """

    def __init__(
        self, geometry: Geometry, weights: Values, images: Sequence[Values], reach: Reach
    ) -> None:
        self._geometry, self._reach = geometry, reach
        self._weights = weights
        self._scenes = np.stack([image.ravel() for image in images])

    def predict(self, place: Values) -> Values:
        """Return (scenes, patterns x embedding pixels) for :data:`NAMES` in SI units."""
        found = Imperfections(**dict(zip(NAMES, place.tolist(), strict=True)))
        geometry = self._geometry
        transfer = make_transfer(
            geometry.camera,
            geometry.scene,
            geometry.embedding,
            reach=self._reach,
            step=_STEP,
            imperfections=found,
            like=np.empty(0),
        )
        measurements = [self._scenes @ transfer(weights) for weights in self._weights]
        return np.concatenate(measurements, axis=1)

    def measurements(self, found: Imperfections) -> Values:
        """Return (scenes, patterns x embedding pixels), stray light included."""
        place = np.array([getattr(found, name) for name in NAMES])
        return strayed(self.predict(place), found.stray_light, self._geometry.embedding.size)

    def slopes(self, place: Values) -> Values:
        """Return the derivatives of the prediction by each of the fit's units, (4, scenes, values).

        They are central differences. Predictions bend over a sub-pixel's pitch, some tens of a
        unit, so steps of ``_SMALL`` are off by 1e-6 of the derivative.
        """
        steps = _SMALL * np.diag(_UNITS)
        differences = [self.predict(place + step) - self.predict(place - step) for step in steps]
        return np.stack(differences) / (2 * _SMALL)


def align(
    geometry: Geometry,
    weights: Values,
    sights: Sequence[SceneReadings],
    start: Imperfections,
    *,
    reach: Reach,
    check: Callable[[], None] = lambda: None,
) -> Alignment:
    """Fit shift, rotation and distance, stray light, and a gain for each scene.

    Stray light falls evenly on the sensor in this model: a share ``s`` of it turns a measurement
    ``y`` into ``(1 - s) y + s mean(y)``.

    Args:
        geometry: the nominal camera.
        weights: (patterns, rows, columns), amplitudes as the panel shows them.
        sights: measurements of several known scenes behind these patterns.
        start: imperfections to begin with; those that are not fitted stay.
        reach: reach of interference between sub-pixels.
        check: function that is called before each evaluation; its exception ends the fit.
    """
    optics = Optics(geometry, weights, [sight.image for sight in sights], reach)
    scales = np.array([sight.scale for sight in sights])
    observed = np.stack(
        [sight.measurements.ravel() / scale for sight, scale in zip(sights, scales, strict=True)]
    )
    begin = np.array([getattr(start, name) for name in NAMES]) / _UNITS
    gains = _gains(optics.predict(begin * _UNITS), observed)
    size = geometry.embedding.size

    def residuals(values: Values) -> Values:
        check()
        seen = strayed(optics.predict(values[:4] * _UNITS), values[4] * _PERCENT, size)
        return np.ravel(values[5:, None] * seen - observed)

    def jacobian(values: Values) -> Values:
        check()
        straight, slopes = optics.predict(values[:4] * _UNITS), optics.slopes(values[:4] * _UNITS)
        stray, gains = values[4] * _PERCENT, values[5:, None]
        columns = np.zeros((len(values), *observed.shape))
        columns[:4] = strayed(slopes, stray, size) * gains
        columns[4] = (strayed(straight, 1.0, size) - straight) * gains * _PERCENT
        for index, row in enumerate(strayed(straight, stray, size)):
            columns[5 + index, index] = row
        return columns.reshape(len(values), -1).T

    found = least_squares(
        residuals,
        jacobian,
        np.concatenate([begin, [0.0], gains]),
        tolerance=1e-6,
        evaluations=_EVALUATIONS,
    )
    spread = uncertainties(found.jacobian, found.residuals)
    place = found.values[:4] * _UNITS
    spread_y, spread_x, spread_angle, spread_distance = (spread[:4] * _UNITS).tolist()
    return Alignment(
        imperfections=replace(
            start,
            # Noise can make the fitted share negative.
            stray_light=min(1.0, max(0.0, float(found.values[4]) * _PERCENT)),
            **dict(zip(NAMES, place.tolist(), strict=True)),
        ),
        uncertainties=(spread_y, spread_x, spread_angle, spread_distance),
        gains=tuple((found.values[5:] * scales).tolist()),
        gain_uncertainties=tuple((spread[5:] * scales).tolist()),
        stray_uncertainty=float(spread[4]) * _PERCENT,
        residuals=tuple(
            np.sqrt(np.mean(found.residuals.reshape(observed.shape) ** 2, axis=1)).tolist()
        ),
    )


def strayed(measurements: Values, share: float, size: int) -> Values:
    """Spread a share of the light of every measurement of so many values evenly over it."""
    each = measurements.reshape(*measurements.shape[:-1], -1, size)
    spread: Values = (1 - share) * each + share * each.mean(-1, keepdims=True)
    return spread.reshape(measurements.shape)


def _gains(predicted: Values, observed: Values) -> Values:
    """Return the best gain of each scene on its own."""
    gains: Values = (predicted * observed).sum(1) / (predicted**2).sum(1)
    return gains
