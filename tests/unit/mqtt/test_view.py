"""What the house is told of what the camera said."""

from __future__ import annotations

import json
from datetime import UTC, datetime

import pytest

from veilcam_client.wire.events import (
    BundleChanged,
    CaptureTaken,
    Event,
    Gap,
    Gone,
    MaskChanged,
    Seen,
    StateChanged,
    WatchChanged,
)
from veilcam_client.wire.status import example_status
from veilcam_client.wire.watch import Belief, Watch, Watching, WatchOff
from veilcam_mqtt.settings import Names
from veilcam_mqtt.view import View, calls_for_a_look, changes_what_is_seen, event_payload

AT = datetime(2026, 1, 2, tzinfo=UTC)
STATUS = example_status()
LOOKING = Watch(policy=Watching(rate_hz=2.0), activity="looking", looks=4)
NAMES = Names("camera")


def believed(label: str | None, confidence: float | None) -> Watch:
    belief = Belief(label=label, confidence=confidence, since=AT, duration_s=1.0, looks=2)
    return LOOKING.model_copy(update={"belief": belief})


def told(view: View, now: float = 0.0) -> dict[str, str]:
    return {
        topic.removeprefix("veilcam/camera/"): payload
        for topic, payload in view.messages(NAMES, now).items()
    }


@pytest.mark.parametrize(
    ("watch", "label", "confidence"),
    [
        (believed("3", 0.987), "3", "99"),
        (believed("3", None), "3", "None"),
        (believed(None, 0.5), "nothing", "50"),
        (LOOKING, "None", "None"),
    ],
)
def test_belief_becomes_label_and_confidence(watch: Watch, label: str, confidence: str) -> None:
    said = told(View.of(STATUS, watch, 0.0))
    assert (said["label"], said["confidence"]) == (label, confidence)


def test_events_change_what_is_said() -> None:
    view = View.of(STATUS, LOOKING, 0.0)
    seen = view.after(Seen(id="1", at=AT, label="7", confidence=0.9, duration_s=0.5), 1.0)
    assert (told(seen)["label"], told(seen)["confidence"]) == ("7", "90")
    left = Gone(id="2", at=AT, label="7", confidence=0.8, duration_s=3.0, reason="left")
    assert told(seen.after(left, 2.0))["label"] == "nothing"
    blind = left.model_copy(update={"reason": "not_looking", "confidence": None})
    assert told(seen.after(blind, 2.0))["label"] == "None"
    state = StateChanged(id="3", at=AT, state="safe", detail="dark", remedy="adjust_light")
    safe = told(view.after(state, 1.0))
    assert safe["health"] == "safe"
    assert json.loads(safe["health_details"]) == {"detail": "dark", "remedy": "adjust_light"}
    capture = CaptureTaken(id="4", at=AT, capture="c", epoch="e")
    assert view.after(capture, 1.0) is view


def test_age_of_the_mask_grows_in_steps() -> None:
    age = STATUS.rotation.epoch_age_s
    assert age == 12.5
    view = View.of(STATUS, LOOKING, 100.0)
    assert [told(view, now)["mask_age"] for now in (100.0, 107.4, 107.5)] == ["10", "10", "20"]
    changed = view.after(MaskChanged(id="1", at=AT, epoch="e2"), 120.0)
    assert [told(changed, now)["mask_age"] for now in (120.0, 129.9, 130.0)] == ["0", "0", "10"]
    # A clock that was read in another order is no negative age.
    assert told(changed, 119.0)["mask_age"] == "0"
    without = STATUS.rotation.model_copy(update={"epoch": None})
    none = View.of(STATUS.model_copy(update={"rotation": without}), LOOKING, 0.0)
    assert told(none)["mask_age"] == "None"


def test_description_comes_first_and_the_cameras_absence_last() -> None:
    view = View.of(STATUS, LOOKING, 0.0)
    first, *_, last = view.messages(NAMES, 0.0)
    assert (first, last) == ("homeassistant/device/camera/config", "veilcam/camera/camera")
    assert told(view)["camera"] == "online"
    assert told(View(STATUS, online=False))["camera"] == "offline"


@pytest.mark.parametrize(
    ("event", "look", "changes"),
    [
        (Gap(id="1", at=AT), True, False),
        (WatchChanged(id="1", at=AT, policy=WatchOff(), activity="off"), True, False),
        (BundleChanged(id="1", at=AT, digest="d", task="t"), True, False),
        (MaskChanged(id="1", at=AT, epoch="e"), False, False),
        (StateChanged(id="1", at=AT, state="ready"), False, True),
        (Seen(id="1", at=AT, label="7", duration_s=1.0), False, True),
    ],
)
def test_event_calls_for_a_look_or_changes_what_is_seen(
    event: Event, look: bool, changes: bool
) -> None:
    assert (calls_for_a_look(event), changes_what_is_seen(event)) == (look, changes)


def test_event_has_the_type_that_home_assistant_looks_for() -> None:
    gone = Gone(id="b-2", at=AT, label="7", confidence=None, duration_s=3.0, reason="left")
    assert json.loads(event_payload(gone)) == {
        "event_type": "gone",
        "at": "2026-01-02T00:00:00Z",
        "label": "7",
        "confidence": None,
        "duration_s": 3.0,
        "reason": "left",
    }


def test_view_reads_nothing_from_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """With every event all of it is put into words: that must not take milliseconds."""
    view = View.of(STATUS, LOOKING, 0.0)
    before = view.messages(NAMES, 0.0)

    def read(*_: object) -> str:
        raise AssertionError("the package's metadata was read")

    monkeypatch.setattr("importlib.metadata.version", read)
    assert view.messages(NAMES, 0.0) == before
