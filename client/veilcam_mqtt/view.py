"""State of the camera as a bridge knows it, and its form for the house."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

from veilcam_client.wire.events import BundleChanged, Event, Gone, MaskChanged, Seen, StateChanged
from veilcam_client.wire.status import Status
from veilcam_client.wire.watch import Watch
from veilcam_mqtt.discovery import (
    CAMERA,
    CONFIDENCE,
    DETAILS,
    HEALTH,
    LABEL,
    MASK_AGE,
    NOTHING,
    OFFLINE,
    ONLINE,
    UNKNOWN,
    discovery,
)
from veilcam_mqtt.settings import Names

AGE_STEP = 10
"""In which the mask's age is told [s]: masks that change with each capture are all of age 0."""


@dataclass(frozen=True, slots=True)
class View:
    """Last state of the camera.

    Attributes:
        status: status as it answered, with the changes that events told since.
        label: label that it sees, ``nothing``, or ``None`` while it does not look or may not tell.
        confidence: probability of that, in [0, 1], where it is told.
        mask_at: time when the mask was shown, by the clock of ``messages`` [s]; None while
            none is.
        online: True while it answers.
    """

    status: Status
    label: str = UNKNOWN
    confidence: float | None = None
    mask_at: float | None = None
    online: bool = True

    @classmethod
    def of(cls, status: Status, watch: Watch, now: float) -> View:
        """Return the view of a camera that just answered, at a time [s]."""
        belief, age = watch.belief, status.rotation.epoch_age_s
        seen = None if belief is None else belief.label
        return cls(
            status,
            UNKNOWN if belief is None else NOTHING if seen is None else seen,
            None if belief is None else belief.confidence,
            None if age is None or status.rotation.epoch is None else now - age,
        )

    def after(self, event: Event, now: float) -> View:
        """Return the view after an event, at a time [s]."""
        match event:
            case StateChanged():
                news = {"state": event.state, "detail": event.detail, "remedy": event.remedy}
                return replace(self, status=self.status.model_copy(update=news))
            case Seen():
                return replace(self, label=event.label, confidence=event.confidence)
            case Gone():
                label = NOTHING if event.reason == "left" else UNKNOWN
                return replace(self, label=label, confidence=event.confidence)
            case MaskChanged():
                return replace(self, mask_at=now)
        return self

    def messages(self, names: Names, now: float) -> dict[str, str]:
        """All retained messages, topic and payload, in the order in which they make sense.

        Args:
            names: names of the topics.
            now: time [s].
        """
        status = self.status
        age = None if self.mask_at is None else AGE_STEP * int((now - self.mask_at) // AGE_STEP)
        sure = None if self.confidence is None else round(100 * self.confidence)
        told = {
            LABEL: self.label,
            CONFIDENCE: UNKNOWN if sure is None else str(sure),
            HEALTH: status.state,
            DETAILS: json.dumps({"detail": status.detail, "remedy": status.remedy}),
            MASK_AGE: UNKNOWN if age is None else str(max(0, age)),
            CAMERA: ONLINE if self.online else OFFLINE,
        }
        described = json.dumps(discovery(status, names), separators=(",", ":"))
        return {
            names.config: described,
            **{names.topic(name): payload for name, payload in told.items()},
        }


def calls_for_a_look(event: Event) -> bool:
    """Return whether an event says that there is more to know than it tells."""
    return isinstance(event, BundleChanged) or event.kind in ("gap", "watch")


def changes_what_is_seen(event: Event) -> bool:
    """Return whether an event tells of more than time that goes by."""
    return isinstance(event, StateChanged | Seen | Gone)


def event_payload(event: Seen | Gone) -> str:
    """Return the message of an event entity, never retained."""
    told = event.model_dump(mode="json", exclude={"id", "kind"})
    return json.dumps({"event_type": event.kind, **told})
