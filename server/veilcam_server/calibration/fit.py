"""Fit of the camera to all measurements of a calibration, and its result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np

from veilcam_client.wire.calibration import CalibrationRecord, Quantity
from veilcam_optics.camera.imperfections import Imperfections
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.transfer.tables import Reach
from veilcam_server.calibration.alignment import NAMES, Alignment, Optics, SceneReadings, align
from veilcam_server.calibration.measurements import Measurements
from veilcam_server.calibration.response import Response, fit_response, least_squares, uncertainties
from veilcam_server.calibration.rig import Geometry, Patterns, Values
from veilcam_server.devices.base import Device, Levels
from veilcam_server.errors import CalibrationError


@dataclass(frozen=True, eq=False, slots=True)
class CalibrationResult:
    """Result of a calibration."""

    measured: Measurements
    response: Response
    alignment: Alignment
    stuck_uncertainty: float
    """Standard uncertainty of the transmittance of dead lines."""
    card_error: float
    """Relative error of predicted measurements of the white card, behind patterns held out."""
    lamp_error: float
    """Relative error of the same measurements of the lamp."""
    lamp_predicted: Values = field(repr=False)
    """Predicted measurement of the lamp behind the last pattern, which no fit uses."""

    @property
    def lamp(self) -> Values:
        """Measurement of the lamp behind the last pattern."""
        seen: Values = self.measured.sights[1].measurements[-1]
        return seen


def make_record(
    found: CalibrationResult, device: Device, *, exposure: float, tab: str | None, geometry: str
) -> CalibrationRecord:
    """Return the record of a calibration.

    Args:
        found: result of the calibration.
        device: device that was calibrated.
        exposure: exposure of the measurements [s].
        tab: tab of the panel.
        geometry: digest of the nominal camera, scene and embedding.
    """
    measured, alignment, response = found.measured, found.alignment, found.response
    imperfections, gain = alignment.imperfections, alignment.gains[0]
    full_scale, settling, lines = device.sensor.full_scale, measured.settling, measured.lines
    black, noise = float(measured.unlit.mean()), float(measured.unlit.std())
    fit = float(np.sqrt(np.mean(np.square(alignment.residuals))))
    gain_spread = alignment.gain_uncertainties[0]

    def placed(name: str) -> Quantity:
        spread = alignment.uncertainties[NAMES.index(name)]
        return Quantity(value=getattr(imperfections, name), uncertainty=spread, residual=fit)

    def shown(value: float, uncertainty: float) -> Quantity:
        return Quantity(value=value, uncertainty=uncertainty, residual=response.residual)

    return CalibrationRecord(
        taken_at=datetime.now(UTC),
        display=device.display.name,
        sensor=device.sensor.name,
        simulated=device.simulated,
        tab=tab,
        exposure_s=exposure,
        geometry=geometry,
        settling_s=Quantity(
            value=settling.seconds,
            uncertainty=settling.uncertainty,
            residual=settling.residual,
        ),
        black_level=Quantity(
            value=black,
            uncertainty=noise / float(np.sqrt(measured.unlit.size)),
            residual=noise / full_scale,
        ),
        gain=Quantity(value=gain, uncertainty=gain_spread, residual=found.card_error),
        full_scale=Quantity(
            value=(full_scale - black) / gain,
            uncertainty=gain_spread * (full_scale - black) / gain**2,
            residual=found.card_error,
        ),
        gamma=shown(response.gamma, response.gamma_uncertainty),
        contrast_floor=shown(response.floor, response.floor_uncertainty),
        dead_rows=lines.dead_rows,
        dead_columns=lines.dead_columns,
        dead_transmittance=Quantity(
            value=imperfections.dead_transmittance,
            uncertainty=found.stuck_uncertainty,
            residual=fit,
        ),
        shift_y_m=placed("shift_y"),
        shift_x_m=placed("shift_x"),
        rotation_rad=placed("rotation"),
        distance_error_m=placed("distance_error"),
        stray_light=Quantity(
            value=imperfections.stray_light,
            uncertainty=alignment.stray_uncertainty,
            residual=fit,
        ),
        psf_residual=found.lamp_error,
        drift=measured.drift,
    )


def split_darkness(
    geometry: Geometry,
    opaque: Sequence[SceneReadings],
    gains: Sequence[float],
    known: Imperfections,
    *,
    reach: Reach,
) -> tuple[Imperfections, float, float]:
    """Fit contrast floor and transmittance of dead lines to measurements behind an opaque panel.

    Args:
        geometry: the nominal camera.
        opaque: scenes behind the opaque panel, one pattern each.
        gains: measurement per predicted measurement of those scenes.
        known: imperfections that were found, such as place of the mask and dead lines.
        reach: reach of interference between sub-pixels.

    Returns:
        The imperfections with both, and their standard uncertainties.
    """
    ones = np.ones(geometry.camera.mask_shape)
    plain = replace(known, gamma=1.0, contrast_floor=0.0, dead_transmittance=0.0)
    alive = plain.shown(ones)
    optics = Optics(
        geometry, np.stack([alive, ones - alive]), [sight.image for sight in opaque], reach
    )
    predicted = optics.measurements(known).reshape(len(opaque), 2, -1)
    columns, values = [], []
    for sight, gain, each in zip(opaque, gains, predicted, strict=True):
        # Scenes keep their scales: the lamp's light may be below a step of the converter.
        columns.append(each.T * gain)
        values.append(sight.measurements.ravel())
    matrix, seen = np.concatenate(columns), np.concatenate(values)
    # Amplitudes are the roots of the fitted shares, and their uncertainties follow to first order.
    light = least_squares(
        lambda shares: matrix @ shares - seen, lambda _: matrix, np.zeros(2), lowest=0.0
    )
    amplitudes = np.sqrt(light.values)
    spread = uncertainties(matrix, light.residuals)
    spread = np.minimum(spread / np.maximum(2 * amplitudes, 1e-9), np.sqrt(spread))
    found = replace(
        known,
        contrast_floor=min(float(amplitudes[0]), 0.99),
        dead_transmittance=min(float(amplitudes[1]), 1.0),
    )
    return found, float(spread[0]), float(spread[1])


_MISFIT = 0.1
"""Largest relative error of predicted measurements behind held-out patterns."""
_ROUNDS = 2
"""Number of rounds in which floor, dead lines and gain are fitted in turn."""
_FARTHEST, _TURNED = 1e-3, 20e-3
"""Largest shift [m] and rotation [rad] that decoders correct."""


def fit(
    measured: Measurements,
    geometry: Geometry,
    *,
    reach: Reach,
    patterns: Patterns,
    check: Callable[[], None],
) -> CalibrationResult:
    """Fit the imperfections of a camera to its measurements.

    Args:
        measured: measurements.
        geometry: the nominal camera.
        reach: reach of interference between sub-pixels.
        patterns: patterns that were shown.
        check: function that is called before each evaluation; its exception ends the fit.

    Raises:
        CalibrationError: no camera fits, or the one that fits is too far from the nominal one.
    """
    return _Fit(geometry, reach, patterns, check).fit(measured)


@dataclass(eq=False, slots=True)
class _Fit:
    geometry: Geometry
    reach: Reach
    patterns: Patterns
    check: Callable[[], None]
    stuck_uncertainty: float = 0.0
    """Standard uncertainty of the transmittance of dead lines."""

    def fit(self, measured: Measurements) -> CalibrationResult:
        """Return the result of all fits."""
        response, alignment = self._fit(measured)
        predicted, errors = self._verdict(measured.levels, measured.sights, alignment)
        return CalibrationResult(
            measured=measured,
            response=response,
            alignment=alignment,
            stuck_uncertainty=self.stuck_uncertainty,
            card_error=errors[0],
            lamp_error=errors[1],
            lamp_predicted=predicted[1, -1],
        )

    def _fit(self, measured: Measurements) -> tuple[Response, Alignment]:
        """Fit coarse patterns first, then all.

        Dead lines add the same unknown light to every pattern. Where there are dead lines, the
        first fits use the light that patterns add to the opaque panel's.
        """
        levels, sights, staircase = measured.levels, measured.sights, measured.staircase
        lines, patterns = measured.lines, self.patterns
        coarse = slice(1, 1 + patterns.coarse)
        every = slice(1, 1 + patterns.coarse + patterns.fine)
        dead = bool(lines.dead_rows or lines.dead_columns)
        response = fit_response(staircase, floor=0.0 if dead else None)
        known = Imperfections(
            gamma=response.gamma,
            contrast_floor=response.floor,
            dead_rows=lines.dead_rows,
            dead_columns=lines.dead_columns,
        )
        added = (
            [
                replace(each, measurements=each.measurements - each.measurements[0])
                for each in sights
            ]
            if dead
            else sights
        )
        alignment = self._align(levels, added, known, coarse)
        alignment = self._align(levels, added, alignment.imperfections, every)
        for _ in range(_ROUNDS if dead else 0):
            opaque = [replace(sight, measurements=sight.measurements[:1]) for sight in sights]
            known, floor_spread, self.stuck_uncertainty = split_darkness(
                self.geometry,
                opaque,
                alignment.gains,
                alignment.imperfections,
                reach=self.reach,
            )
            response = fit_response(
                staircase, floor=known.contrast_floor, floor_uncertainty=floor_spread
            )
            known = replace(known, gamma=response.gamma)
            alignment = self._align(levels, sights, known, every)
        return response, alignment

    def _align(
        self,
        levels: Sequence[Levels],
        sights: Sequence[SceneReadings],
        start: Imperfections,
        used: slice,
    ) -> Alignment:
        return align(
            self.geometry,
            self._shown(levels[used], start),
            [replace(sight, measurements=sight.measurements[used]) for sight in sights],
            start,
            reach=self.reach,
            check=self.check,
        )

    def _shown(self, levels: Sequence[Levels], known: Imperfections) -> Values:
        panel = self.geometry.camera.panel
        return np.stack([known.shown(to_weights(each, panel)) for each in levels])

    def _verdict(
        self, levels: Sequence[Levels], sights: Sequence[SceneReadings], alignment: Alignment
    ) -> tuple[Values, tuple[float, ...]]:
        """Return predictions for held-out patterns, and their relative error for each scene."""
        found = alignment.imperfections
        for name, amount, limit, unit in (
            ("shifted", max(abs(found.shift_y), abs(found.shift_x)), _FARTHEST, 1e-3),
            ("turned", abs(found.rotation), _TURNED, 1e-3),
        ):
            if amount > limit:
                kind = "mm" if name == "shifted" else "mrad"
                raise CalibrationError(
                    f"the panel is {name} by {amount / unit:.3g} {kind}, more than decoders can "
                    f"take in ({limit / unit:g}): mount it anew, or check where the card was"
                )
        held_out = slice(-self.patterns.held_out, None)
        optics = Optics(
            self.geometry,
            self._shown(levels[held_out], found),
            [sight.image for sight in sights],
            self.reach,
        )
        gains = np.array(alignment.gains)[:, None, None, None]
        shape = (len(sights), -1, *self.geometry.embedding.shape)
        predicted: Values = gains * optics.measurements(found).reshape(shape)
        seen = np.stack([sight.measurements[held_out] for sight in sights])
        axes = (1, 2, 3)
        errors = np.sqrt(((predicted - seen) ** 2).sum(axes) / (seen**2).sum(axes))
        for name, error in zip(("white card", "lamp"), errors, strict=True):
            if error > _MISFIT:
                raise CalibrationError(
                    f"measurements of the {name} are {100 * error:.2g} % off the optics' "
                    "prediction: check that card and lamp were where they should be, and no other "
                    "light was on"
                )
        return predicted, tuple(errors.tolist())
