"""The camera measured with itself: what panel, sensor and their distance really are."""

from veilcam_server.calibration.errors import CalibrationError
from veilcam_server.calibration.measurements import Effort
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
    "Calibrated",
    "CalibrationError",
    "CalibrationScene",
    "Effort",
    "Geometry",
    "SigningKey",
    "calibrate",
    "correction",
    "read_record",
    "sign_record",
    "write_record",
]
