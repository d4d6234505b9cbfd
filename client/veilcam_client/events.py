"""Events of a camera, as ``camera.events()`` gives them."""

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

__all__ = [
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
]
