"""Events of the daemon's event stream."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, TypeAdapter

from veilcam_client.wire.base import EXAMPLE_EPOCH, EXAMPLE_TIME, Answer
from veilcam_client.wire.calibration import CalibrationRun
from veilcam_client.wire.rotation import RotationPolicy
from veilcam_client.wire.status import Remedy, State
from veilcam_client.wire.watch import Activity, Belief, Sighting, WatchPolicy


class _Event(Answer):
    id: str
    """Send it as ``Last-Event-ID`` to go on after this event."""
    at: datetime
    """Time of the event."""


class StateChanged(_Event):
    """The daemon became ready, safe, ..."""

    kind: Literal["state"] = "state"
    """Kind of the event."""
    state: State
    """State from now on."""
    detail: str | None = None
    """Reason, where the state is not ``ready``."""
    remedy: Remedy | None = None
    """Remedy, where the state is ``degraded`` or ``safe``."""


class MaskChanged(_Event):
    """A new mask is on the panel."""

    kind: Literal["mask"] = "mask"
    """Kind of the event."""
    epoch: str
    """Random name of one showing of one mask."""


class CaptureTaken(_Event):
    """An embedding was taken."""

    kind: Literal["capture"] = "capture"
    """Kind of the event."""
    capture: str
    """The first 16 digits of the answer's id."""
    epoch: str
    """Random name of one showing of one mask."""
    replay: bool = False
    """True: it comes from a recording."""


class Classified(_Event):
    """A capture got its label."""

    kind: Literal["classification"] = "classification"
    """Kind of the event."""
    capture: str
    """Name of the capture, as of :class:`CaptureTaken`."""
    epoch: str
    """Random name of one showing of one mask."""
    label: str
    """Most probable label."""
    replay: bool = False
    """True: the label comes from a recording."""


class RotationChanged(_Event):
    """Another rotation policy holds."""

    kind: Literal["rotation"] = "rotation"
    """Kind of the event."""
    policy: RotationPolicy
    """Policy from now on."""


class WatchChanged(_Event):
    """Another watch policy holds, or the camera began to look by itself, or ended."""

    kind: Literal["watch"] = "watch"
    """Kind of the event."""
    policy: WatchPolicy
    """Policy from now on."""
    activity: Activity
    """Activity from now on."""
    detail: str | None = None
    """Why it does not look."""


class Believed(_Event):
    """Whole state of a camera that looks by itself, told at the scheduled time of each look.

    It has no id, and none is kept. The SDK makes :class:`Seen` and :class:`Gone` of what differs
    from one to the next.
    """

    kind: Literal["belief"] = "belief"
    """Kind of the event."""
    belief: Belief | None = None
    """Belief after the look before; None while the camera does not look."""
    sighting: Sighting | None = None
    """Object that is there; None: there is none."""


class Seen(_Event):
    """The camera, which looks by itself, believes to see something that was not there before."""

    kind: Literal["seen"] = "seen"
    """Kind of the event."""
    label: str
    """Label of the object."""
    confidence: float | None = None
    """Probability of the label, in [0, 1]; as of :class:`Classification`."""
    duration_s: float
    """Time since the first capture that told of it [s]."""


class Gone(_Event):
    """End of a sighting: the object is gone, or the camera stopped to look."""

    kind: Literal["gone"] = "gone"
    """Kind of the event."""
    label: str
    """Label of the object."""
    confidence: float | None = None
    """Probability that it is there no longer, in [0, 1]; as of :class:`Seen`. None where ``reason``
    is ``not_looking``, too."""
    duration_s: float
    """Time that it was there [s]."""
    reason: Literal["left", "not_looking"]
    """``left``: the object; ``not_looking``: the camera looks no longer."""


class BundleChanged(_Event):
    """Masks and classifiers come from another bundle."""

    kind: Literal["bundle"] = "bundle"
    """Kind of the event."""
    digest: str
    """SHA-256 of the file."""
    task: str
    """Name of the task."""
    version: int = 0
    """Version that its owner chose; 0: none."""
    older: bool = False
    """True: the version is lower than that of the bundle before."""


class CalibrationChanged(_Event):
    """A calibration goes on, or ended."""

    kind: Literal["calibration"] = "calibration"
    """Kind of the event."""
    run: CalibrationRun
    """Progress of the calibration."""


class Fault(_Event):
    """Something failed; ``code`` is that of the problem."""

    kind: Literal["fault"] = "fault"
    """Kind of the event."""
    code: str
    """Code of the problem."""
    detail: str
    """Description of the fault."""
    remedy: Remedy = "wait"
    """Remedy."""


class Gap(_Event):
    """Events were missed here; ``missed`` is None when the daemon was restarted in between."""

    kind: Literal["gap"] = "gap"
    """Kind of the event."""
    missed: int | None = None
    """Number of missed events; None after a restart."""


Event = Annotated[
    StateChanged
    | MaskChanged
    | CaptureTaken
    | Classified
    | RotationChanged
    | WatchChanged
    | Believed
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
        *("state", "mask", "capture", "classification", "rotation", "watch", "belief", "seen"),
        *("gone", "bundle", "calibration", "fault", "gap"),
    )
)


def examples() -> tuple[MaskChanged]:
    """Return examples for documents."""
    return (MaskChanged(id="5ca1ab1e-7", at=EXAMPLE_TIME, epoch=EXAMPLE_EPOCH),)
