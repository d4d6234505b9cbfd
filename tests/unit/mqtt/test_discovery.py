"""What Home Assistant is told of the device."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from jsonschema import (  # type: ignore[import-untyped]
    Draft202012Validator,
    ValidationError,
)

from veilcam_client.wire.status import example_status
from veilcam_mqtt.discovery import discovery
from veilcam_mqtt.settings import Names

SCHEMA = json.loads((Path(__file__).parent / "discovery_schema.json").read_text())
NAMES = Names("camera")
STATUS = example_status()
PAYLOAD = discovery(STATUS, NAMES)


def check(payload: dict[str, Any]) -> None:
    Draft202012Validator(SCHEMA).validate(payload)


def test_description_is_what_home_assistant_takes() -> None:
    check(json.loads(json.dumps(PAYLOAD)))


def without(*path: str) -> Callable[[dict[str, Any]], None]:
    def change(payload: dict[str, Any]) -> None:
        for key in path[:-1]:
            payload = payload[key]
        del payload[path[-1]]

    return change


@pytest.mark.parametrize(
    "change",
    [
        without("origin"),
        without("device", "identifiers"),
        without("components", "label", "unique_id"),
        without("components", "label", "options"),
        without("components", "event", "event_types"),
        lambda payload: payload.update(availability_topic="a"),
        lambda payload: payload.update(expire_after=5),
        lambda payload: payload["components"]["label"].update(unit_of_measurement="x"),
        lambda payload: payload["components"]["label"].update(options=[]),
        lambda payload: payload["components"]["off"].update(state_topic="a"),
        lambda payload: payload["components"].update({"a b": payload["components"]["off"]}),
    ],
)
def test_schema_refuses_what_home_assistant_refuses(
    change: Callable[[dict[str, Any]], None],
) -> None:
    payload = copy.deepcopy(PAYLOAD)
    change(payload)
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
        "label": "sensor",
        "confidence": "sensor",
        "health": "sensor",
        "mask_age": "sensor",
        "event": "event",
        "rotate": "button",
        "off": "button",
    }


def test_description_tells_no_secret() -> None:
    told = json.dumps(PAYLOAD)
    assert STATUS.device.key not in told
    assert STATUS.receivers[0].label not in told
