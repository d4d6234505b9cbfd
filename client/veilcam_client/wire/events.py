"""Events of the daemon's event stream."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, TypeAdapter

from veilcam_client.wire.base import EXAMPLE_EPOCH, EXAMPLE_TIME, Answer, Examples
from veilcam_client.wire.calibration import CalibrationRun
from veilcam_client.wire.rotation import RotationPolicy
from veilcam_client.wire.status import Remedy, State
from veilcam_client.wire.watch import Activity, WatchPolicy


class _Event(Answer):
    id: str
    """Send it as ``Last-Event-ID`` to go on after this event."""
    at: datetime


class StateChanged(_Event):
    """The daemon became ready, safe, ..."""

    kind: Literal["state"] = "state"
    state: State
    detail: str | None = None
    remedy: Remedy | None = None
    """What helps, where the state is ``degraded`` or ``safe``."""


class MaskChanged(_Event):
    """A new mask is on the panel."""

    kind: Literal["mask"] = "mask"
    epoch: str


class CaptureTaken(_Event):
    """An embedding was taken."""

    kind: Literal["capture"] = "capture"
    capture: str
    """The first 16 digits of the answer's id."""
    epoch: str
    replay: bool = False
    """Whether it comes from a recording."""


class Classified(_Event):
    """A capture got its label."""

    kind: Literal["classification"] = "classification"
    capture: str
    """As of :class:`CaptureTaken`."""
    epoch: str
    label: str
    replay: bool = False
    """Whether the label comes from a recording."""


class RotationChanged(_Event):
    """Another rotation policy holds."""

    kind: Literal["rotation"] = "rotation"
    policy: RotationPolicy


class WatchChanged(_Event):
    """Another watch policy holds, or the camera began to look by itself, or ended."""

    kind: Literal["watch"] = "watch"
    policy: WatchPolicy
    activity: Activity
    detail: str | None = None
    """Why it does not look."""


class Seen(_Event):
    """The camera, which looks by itself, believes to see something that was not there before."""

    kind: Literal["seen"] = "seen"
    label: str
    confidence: float | None = None
    """Probability of the label, in [0, 1]; None without a scope for scores, and in tenths with
    ``read:scores:rounded``."""
    duration_s: float
    """How long it has been there by now: since the first capture that told of it."""


class Gone(_Event):
    """End of a sighting: the object is gone, or the camera stopped to look."""

    kind: Literal["gone"] = "gone"
    label: str
    """What was seen."""
    confidence: float | None = None
    """Probability that it is there no longer; as of :class:`Seen`. None where ``reason`` is
    ``not_looking``, too."""
    duration_s: float
    """How long it was there."""
    reason: Literal["left", "not_looking"]


class BundleChanged(_Event):
    """Masks and classifiers come from another bundle."""

    kind: Literal["bundle"] = "bundle"
    digest: str
    task: str
    version: int = 0
    """Of its owner's choice; 0 for one that has none."""
    older: bool = False
    """Whether that is lower than the version of the bundle before."""


class CalibrationChanged(_Event):
    """A calibration goes on, or ended."""

    kind: Literal["calibration"] = "calibration"
    run: CalibrationRun


class Fault(_Event):
    """Something failed; ``code`` is that of the problem."""

    kind: Literal["fault"] = "fault"
    code: str
    detail: str
    remedy: Remedy = "wait"
    """What helps."""


class Gap(_Event):
    """Events were missed here; ``missed`` is None when the daemon was restarted in between."""

    kind: Literal["gap"] = "gap"
    missed: int | None = None


Event = Annotated[
    StateChanged
    | MaskChanged
    | CaptureTaken
    | Classified
    | RotationChanged
    | WatchChanged
    | Seen
    | Gone
    | BundleChanged
    | CalibrationChanged
    | Fault
    | Gap,
    Field(discriminator="kind"),
]

EVENT: TypeAdapter[Event] = TypeAdapter(Event, config=ConfigDict(defer_build=True))
EVENT_KINDS = frozenset(
    (
        *("state", "mask", "capture", "classification", "rotation", "watch", "seen", "gone"),
        *("bundle", "calibration", "fault", "gap"),
    )
)


EXAMPLES = Examples(lambda: (MaskChanged(id="5ca1ab1e-7", at=EXAMPLE_TIME, epoch=EXAMPLE_EPOCH),))
