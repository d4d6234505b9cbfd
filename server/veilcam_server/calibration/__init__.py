"""The camera measured with itself: what panel, sensor and their distance really are."""

from veilcam_server.calibration.effort import Effort
from veilcam_server.calibration.errors import CalibrationError
from veilcam_server.calibration.geometry import Geometry
from veilcam_server.calibration.record import correction, read_record, sign_record, write_record
from veilcam_server.calibration.run import Calibrated, calibrate
from veilcam_server.calibration.scenes import CalibrationScene
from veilcam_server.calibration.sensor import CalibratedSensor
from veilcam_server.calibration.signing import SigningKey

__all__ = [
    "Calibrated",
    "CalibratedSensor",
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
