"""What Home Assistant is told of the device."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator, ValidationError  # type: ignore[import-untyped]

from veilcam_client.wire.status import example_status
from veilcam_mqtt.discovery import discovery
from veilcam_mqtt.settings import Names

SCHEMA = json.loads((Path(__file__).parent / "discovery_schema.json").read_text())
NAMES = Names("camera")
STATUS = example_status()
PAYLOAD = discovery(STATUS, NAMES)
check = Draft202012Validator(SCHEMA).validate


def test_description_is_what_home_assistant_takes() -> None:
    check(json.loads(json.dumps(PAYLOAD)))


@pytest.mark.parametrize(
    ("label", "change"),
    [
        (None, {"availability_topic": "a"}),
        (None, {"expire_after": 5}),
        ("label", {"options": []}),
        ("label", {"unit_of_measurement": "x"}),
        ("off", {"state_topic": "a"}),
        ("event", {"event_types": None}),
    ],
)
def test_schema_refuses_what_home_assistant_refuses(
    label: str | None, change: dict[str, object]
) -> None:
    payload = copy.deepcopy(PAYLOAD)
    (payload["components"][label] if label else payload).update(change)
    with pytest.raises(ValidationError):
        check(payload)


def test_every_entity_is_there_only_with_bridge_and_camera() -> None:
    assert [each["topic"] for each in PAYLOAD["availability"]] == [
        "veilcam/camera/bridge",
        "veilcam/camera/camera",
    ]
    assert PAYLOAD["availability_mode"] == "all"
    assert not any("availability" in entity for entity in PAYLOAD["components"].values())


def test_label_may_be_any_of_the_bundle_or_nothing() -> None:
    labels = STATUS.bundle.labels
    assert PAYLOAD["components"]["label"]["options"] == [*labels, "nothing"]
    assert {name: entity["platform"] for name, entity in PAYLOAD["components"].items()} == {
        **dict.fromkeys(("label", "confidence", "health", "mask_age"), "sensor"),
        "event": "event",
        "rotate": "button",
        "off": "button",
    }


def test_description_tells_no_secret() -> None:
    assert STATUS.device.key not in json.dumps(PAYLOAD)
    assert STATUS.receivers[0].label not in json.dumps(PAYLOAD)
