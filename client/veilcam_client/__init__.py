"""Client SDK for Veilcam: ask a privacy camera what it sees.

from veilcam_client import Camera

with Camera("http://127.0.0.1:8787") as camera:
    print(camera.classify().label)
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from veilcam_client.async_camera import AsyncCamera
    from veilcam_client.camera import Camera
    from veilcam_client.collecting import Shot, collect, held_before, labelled_pictures
    from veilcam_client.decoding import SceneDecoder
    from veilcam_client.discovery import FoundCamera
    from veilcam_client.errors import (
        ApiError,
        ArgumentError,
        BusyError,
        ConnectError,
        DeviceError,
        DiscoveryError,
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
    from veilcam_client.http.answers import RawResponse
    from veilcam_client.http.async_streams import AsyncEventStream
    from veilcam_client.http.options import DEFAULT_URL
    from veilcam_client.http.streams import EventStream
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
    from veilcam_client.wire.events import (
        BundleChanged,
        CalibrationChanged,
        CaptureTaken,
        Classified,
        Event,
        Fault,
        Gap,
        Gone,
        MaskChanged,
        RotationChanged,
        Seen,
        StateChanged,
        WatchChanged,
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
    from veilcam_client.wire.simulation import (
        Faults,
        HeldScene,
        LightFaults,
        PanelFaults,
        SensorFaults,
    )
    from veilcam_client.wire.status import Diagnostics, Status
    from veilcam_client.wire.tokens import NewToken, Scope, Token
    from veilcam_client.wire.watch import (
        Belief,
        OnRequest,
        QuietHours,
        Sighting,
        Watch,
        Watching,
        WatchOff,
        WatchPolicy,
    )

    __version__: str

_OWNERS = {
    "async_camera": ("AsyncCamera",),
    "camera": ("Camera",),
    "collecting": (
        "Shot",
        "collect",
        "held_before",
        "labelled_pictures",
    ),
    "decoding": ("SceneDecoder",),
    "discovery": ("FoundCamera",),
    "errors": (
        "ApiError",
        "ArgumentError",
        "BusyError",
        "ConnectError",
        "DeviceError",
        "DiscoveryError",
        "ForbiddenError",
        "InvalidRequestError",
        "KeyFileError",
        "LeasedError",
        "LogFileError",
        "ProtocolError",
        "RecordingError",
        "RequestTimeoutError",
        "SealedError",
        "ServerError",
        "UnauthorizedError",
        "VeilcamError",
    ),
    "http.answers": ("RawResponse",),
    "http.async_streams": ("AsyncEventStream",),
    "http.options": ("DEFAULT_URL",),
    "http.streams": ("EventStream",),
    "log_file": (
        "fetch_log",
        "verify_log",
    ),
    "recording": (
        "Recording",
        "read_recording",
        "record",
    ),
    "wire.bundles": ("InstalledBundle",),
    "wire.calibration": (
        "CalibrationRecord",
        "CalibrationRun",
        "CalibrationStatus",
        "SignedCalibration",
    ),
    "wire.captures": (
        "Capture",
        "Classification",
        "Embedding",
        "Notes",
        "SealedEmbedding",
    ),
    "wire.events": (
        "BundleChanged",
        "CalibrationChanged",
        "CaptureTaken",
        "Classified",
        "Event",
        "Fault",
        "Gap",
        "Gone",
        "MaskChanged",
        "RotationChanged",
        "Seen",
        "StateChanged",
        "WatchChanged",
    ),
    "wire.lease": (
        "Lease",
        "NewLease",
    ),
    "wire.log": (
        "LogHead",
        "LogRecord",
        "LogRecords",
    ),
    "wire.rotation": (
        "EveryCaptures",
        "EverySeconds",
        "Rotation",
        "RotationOff",
        "RotationPolicy",
    ),
    "wire.sealing": (
        "PairedReceiver",
        "Receivers",
    ),
    "wire.simulation": (
        "Faults",
        "HeldScene",
        "LightFaults",
        "PanelFaults",
        "SensorFaults",
    ),
    "wire.status": ("Diagnostics", "Status"),
    "wire.tokens": (
        "NewToken",
        "Scope",
        "Token",
    ),
    "wire.watch": (
        "Belief",
        "OnRequest",
        "QuietHours",
        "Sighting",
        "Watch",
        "WatchOff",
        "WatchPolicy",
        "Watching",
    ),
}
"""Modules of the public names, which are imported when a name is asked for (PEP 562): whoever needs
the words of the wire alone, as the daemon does, need not wait for HTTP."""

__all__ = [
    "DEFAULT_URL",
    "ApiError",
    "ArgumentError",
    "AsyncCamera",
    "AsyncEventStream",
    "Belief",
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
    "DiscoveryError",
    "Embedding",
    "Event",
    "EventStream",
    "EveryCaptures",
    "EverySeconds",
    "Fault",
    "Faults",
    "ForbiddenError",
    "FoundCamera",
    "Gap",
    "Gone",
    "HeldScene",
    "InstalledBundle",
    "InvalidRequestError",
    "KeyFileError",
    "Lease",
    "LeasedError",
    "LightFaults",
    "LogFileError",
    "LogHead",
    "LogRecord",
    "LogRecords",
    "MaskChanged",
    "NewLease",
    "NewToken",
    "Notes",
    "OnRequest",
    "PairedReceiver",
    "PanelFaults",
    "ProtocolError",
    "QuietHours",
    "RawResponse",
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
    "Seen",
    "SensorFaults",
    "ServerError",
    "Shot",
    "Sighting",
    "SignedCalibration",
    "StateChanged",
    "Status",
    "Token",
    "UnauthorizedError",
    "VeilcamError",
    "Watch",
    "WatchChanged",
    "WatchOff",
    "WatchPolicy",
    "Watching",
    "__version__",
    "collect",
    "fetch_log",
    "held_before",
    "labelled_pictures",
    "read_recording",
    "record",
    "verify_log",
]


def __getattr__(name: str) -> object:
    if name == "__version__":
        return import_module(f"{__name__}.wire.base").installed_version()
    for owner, names in _OWNERS.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{owner}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
