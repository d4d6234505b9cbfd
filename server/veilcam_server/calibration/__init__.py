"""The camera measured with itself: what panel, sensor and their distance really are."""

from veilcam_server.calibration.measurements import Budget
from veilcam_server.calibration.procedure import Calibrated, calibrate
from veilcam_server.calibration.record import (
    SigningKey,
    correction,
    read_record,
    sign_record,
    write_record,
)
from veilcam_server.calibration.rig import Geometry
from veilcam_server.calibration.targets import CalibrationScene

__all__ = [
    "Budget",
    "Calibrated",
    "CalibrationScene",
    "Geometry",
    "SigningKey",
    "calibrate",
    "correction",
    "read_record",
    "sign_record",
    "write_record",
]
