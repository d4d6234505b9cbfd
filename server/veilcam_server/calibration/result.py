"""All that was measured and fitted, and the record that is made of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np

from veilcam_client.wire.calibration import CalibrationRecord, Quantity
from veilcam_server.calibration.alignment import NAMES, Alignment
from veilcam_server.calibration.measurements import Measurements
from veilcam_server.calibration.response import Response
from veilcam_server.calibration.rig import Values
from veilcam_server.devices.base import Device


@dataclass(frozen=True, eq=False, slots=True)
class CalibrationResult:
    """Result of a calibration."""

    measured: Measurements
    response: Response
    alignment: Alignment
    stuck_uncertainty: float
    """Standard uncertainty of what dead lines let through."""
    card_error: float
    """Relative error of predicted measurements of the white card, behind patterns held out."""
    lamp_error: float
    """The same of the lamp."""
    lamp_predicted: Values = field(repr=False)
    """What should be read of the lamp behind the last pattern, which no fit has seen."""

    @property
    def lamp(self) -> Values:
        """Measurements of it."""
        seen: Values = self.measured.sights[1].measurements[-1]
        return seen


def make_record(
    found: CalibrationResult, device: Device, *, exposure: float, tab: str | None, geometry: str
) -> CalibrationRecord:
    """Return what a daemon needs to know.

    Args:
        found: measured and fitted.
        device: device that was calibrated.
        exposure: exposure that measurements are given for [s].
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
