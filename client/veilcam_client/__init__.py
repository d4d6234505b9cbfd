"""Client SDK for Veilcam: ask a privacy camera what it sees.

from veilcam_client import Camera

with Camera("http://127.0.0.1:8787") as camera:
    print(camera.classify().label)
"""

from importlib.metadata import version

from veilcam_client.async_camera import AsyncCamera
from veilcam_client.camera import DEFAULT_URL, Camera
from veilcam_client.decoding import SceneDecoder
from veilcam_client.errors import (
    ApiError,
    BusyError,
    ConnectError,
    DeviceError,
    ForbiddenError,
    InvalidRequestError,
    KeyFileError,
    LeasedError,
    LogFileError,
    ProtocolError,
    RecordingError,
    RequestTimeoutError,
    SealedError,
    ServerError,
    UnauthorizedError,
    VeilcamError,
)
from veilcam_client.log_file import fetch_log, verify_log
from veilcam_client.recording import Recording, read_recording, record
from veilcam_client.wire.bundles import InstalledBundle
from veilcam_client.wire.calibration import (
    CalibrationRecord,
    CalibrationRun,
    CalibrationStatus,
    SignedCalibration,
)
from veilcam_client.wire.captures import (
    Capture,
    Classification,
    Embedding,
    Notes,
    SealedEmbedding,
)
from veilcam_client.wire.diagnostics import Diagnostics
from veilcam_client.wire.events import (
    BundleChanged,
    CalibrationChanged,
    CaptureTaken,
    Classified,
    Event,
    Fault,
    Gap,
    MaskChanged,
    RotationChanged,
    StateChanged,
)
from veilcam_client.wire.lease import Lease, NewLease
from veilcam_client.wire.log import LogHead, LogRecord, LogRecords
from veilcam_client.wire.rotation import (
    EveryCaptures,
    EverySeconds,
    Rotation,
    RotationOff,
    RotationPolicy,
)
from veilcam_client.wire.sealing import PairedReceiver, Receivers
from veilcam_client.wire.simulation import Faults, HeldScene, PanelFaults, SensorFaults
from veilcam_client.wire.status import Status
from veilcam_client.wire.tokens import NewToken, Scope, Token

__version__ = version("veilcam")

__all__ = [
    "DEFAULT_URL",
    "ApiError",
    "AsyncCamera",
    "BundleChanged",
    "BusyError",
    "CalibrationChanged",
    "CalibrationRecord",
    "CalibrationRun",
    "CalibrationStatus",
    "Camera",
    "Capture",
    "CaptureTaken",
    "Classification",
    "Classified",
    "ConnectError",
    "DeviceError",
    "Diagnostics",
    "Embedding",
    "Event",
    "EveryCaptures",
    "EverySeconds",
    "Fault",
    "Faults",
    "ForbiddenError",
    "Gap",
    "HeldScene",
    "InstalledBundle",
    "InvalidRequestError",
    "KeyFileError",
    "Lease",
    "LeasedError",
    "LogFileError",
    "LogHead",
    "LogRecord",
    "LogRecords",
    "MaskChanged",
    "NewLease",
    "NewToken",
    "Notes",
    "PairedReceiver",
    "PanelFaults",
    "ProtocolError",
    "Receivers",
    "Recording",
    "RecordingError",
    "RequestTimeoutError",
    "Rotation",
    "RotationChanged",
    "RotationOff",
    "RotationPolicy",
    "SceneDecoder",
    "Scope",
    "SealedEmbedding",
    "SealedError",
    "SensorFaults",
    "ServerError",
    "SignedCalibration",
    "StateChanged",
    "Status",
    "Token",
    "UnauthorizedError",
    "VeilcamError",
    "__version__",
    "fetch_log",
    "read_recording",
    "record",
    "verify_log",
]
