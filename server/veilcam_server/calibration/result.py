"""All that was measured and fitted, and the record that is made of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np

from veilcam_client.wire.calibration import CalibrationRecord, Quantity
from veilcam_server.calibration.alignment import NAMES, Alignment
from veilcam_server.calibration.lines import Lines
from veilcam_server.calibration.response import Response, Staircase
from veilcam_server.calibration.rig import Values
from veilcam_server.calibration.settling import Settling
from veilcam_server.devices.base import Device


@dataclass(frozen=True, eq=False, slots=True)
class CalibrationResult:
    """What a calibration came to."""

    unlit: Values = field(repr=False)
    """Readings in the dark."""
    settling: Settling
    lines: Lines
    staircase: Staircase
    response: Response
    alignment: Alignment
    stuck_uncertainty: float
    """Standard uncertainty of what dead lines let through."""
    card_error: float
    """Relative error of predicted readings of the white card, behind patterns held out."""
    lamp_error: float
    """The same of the lamp."""
    drift: float
    seen: Values = field(repr=False)
    """The lamp behind a pattern that no fit has seen, as read."""
    predicted: Values = field(repr=False)
    """The same as predicted."""

    @property
    def black_level(self) -> float:
        """Mean reading in the dark."""
        return float(self.unlit.mean())


def make_record(
    found: CalibrationResult, device: Device, *, exposure: float, tab: str | None, geometry: str
) -> CalibrationRecord:
    """Return what a daemon needs to know.

    Args:
        found: measured and fitted.
        device: that it is of.
        exposure: that readings are given for [s].
        tab: of the panel.
        geometry: digest of the drawing.
    """
    alignment, response = found.alignment, found.response
    calibration, gain = alignment.calibration, alignment.gains[0]
    full_scale, black, noise = device.sensor.full_scale, found.black_level, float(found.unlit.std())
    fit = float(np.sqrt(np.mean(np.square(alignment.residuals))))
    gain_spread = alignment.gain_uncertainties[0]

    def placed(name: str) -> Quantity:
        spread = alignment.uncertainties[NAMES.index(name)]
        return Quantity(value=getattr(calibration, name), uncertainty=spread, residual=fit)

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
            value=found.settling.seconds,
            uncertainty=found.settling.uncertainty,
            residual=found.settling.residual,
        ),
        black_level=Quantity(
            value=black,
            uncertainty=noise / float(np.sqrt(found.unlit.size)),
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
        dead_rows=found.lines.dead_rows,
        dead_columns=found.lines.dead_columns,
        dead_transmittance=Quantity(
            value=calibration.dead_transmittance,
            uncertainty=found.stuck_uncertainty,
            residual=fit,
        ),
        shift_y_m=placed("shift_y"),
        shift_x_m=placed("shift_x"),
        rotation_rad=placed("rotation"),
        distance_error_m=placed("distance_error"),
        stray_light=Quantity(
            value=alignment.stray, uncertainty=alignment.stray_uncertainty, residual=fit
        ),
        psf_residual=found.lamp_error,
        drift=found.drift,
    )
