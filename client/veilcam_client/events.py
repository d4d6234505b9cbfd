"""Events of a camera, as ``camera.events()`` gives them."""

from veilcam_client.wire.events import (
    BundleChanged as BundleChanged,
    CalibrationChanged as CalibrationChanged,
    CaptureTaken as CaptureTaken,
    Classified as Classified,
    Event as Event,
    Fault as Fault,
    Gap as Gap,
    Gone as Gone,
    MaskChanged as MaskChanged,
    RotationChanged as RotationChanged,
    Seen as Seen,
    StateChanged as StateChanged,
    WatchChanged as WatchChanged,
)
