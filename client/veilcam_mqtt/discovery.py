"""MQTT device discovery for Home Assistant: one retained message.

https://www.home-assistant.io/integrations/mqtt/#device-discovery-payload, full names throughout.
"""

from __future__ import annotations

from typing import Any, get_args

from veilcam_client.wire.base import installed_version
from veilcam_client.wire.status import State, Status
from veilcam_mqtt.settings import Names

BRIDGE, CAMERA = "bridge", "camera"
"""Topics that say whether the bridge and the camera are there."""
ONLINE, OFFLINE = "online", "offline"
LABEL, CONFIDENCE, HEALTH, DETAILS = "label", "confidence", "health", "health_details"
MASK_AGE, EVENT = "mask_age", "event"
NOTHING = "nothing"
"""State of the label while the camera looks, and nothing is there."""
UNKNOWN = "None"
"""Home Assistant's word for a state that is not known."""
EVENT_TYPES = ("seen", "gone")
ROTATE, OFF = "rotate", "off"
BUTTONS = (ROTATE, OFF)
PRESS = "PRESS"


def discovery(status: Status, names: Names) -> dict[str, Any]:
    """Describe the device.

    Args:
        status: status of the camera.
        names: names of its topics.
    """
    device = status.device
    return {
        "device": {
            "identifiers": [names.node],
            "name": "Veilcam",
            "manufacturer": "Veilcam",
            "model": f"{device.display} and {device.sensor}",
            "sw_version": status.version,
        },
        "origin": {"name": "veilcam-mqtt", "sw_version": installed_version()},
        "availability": [
            {
                "topic": names.topic(topic),
                "payload_available": ONLINE,
                "payload_not_available": OFFLINE,
            }
            for topic in (BRIDGE, CAMERA)
        ],
        "availability_mode": "all",
        "qos": 1,
        "components": {
            name: {"unique_id": f"{names.node}_{name}", **entity}
            for name, entity in _entities(status, names).items()
        },
    }


def _entities(status: Status, names: Names) -> dict[str, dict[str, Any]]:
    return {
        LABEL: {
            "platform": "sensor",
            "name": "Label",
            "icon": "mdi:eye-outline",
            "device_class": "enum",
            "options": [*status.bundle.labels, NOTHING],
            "state_topic": names.topic(LABEL),
        },
        CONFIDENCE: {
            "platform": "sensor",
            "name": "Confidence",
            "icon": "mdi:percent-outline",
            "unit_of_measurement": "%",
            "state_class": "measurement",
            "state_topic": names.topic(CONFIDENCE),
        },
        HEALTH: {
            "platform": "sensor",
            "name": "Health",
            "icon": "mdi:heart-pulse",
            "device_class": "enum",
            "options": list(get_args(State)),
            "entity_category": "diagnostic",
            "state_topic": names.topic(HEALTH),
            "json_attributes_topic": names.topic(DETAILS),
        },
        MASK_AGE: {
            "platform": "sensor",
            "name": "Mask age",
            "device_class": "duration",
            "unit_of_measurement": "s",
            "state_class": "measurement",
            "entity_category": "diagnostic",
            "state_topic": names.topic(MASK_AGE),
        },
        EVENT: {
            "platform": "event",
            "name": "Presence",
            "icon": "mdi:motion-sensor",
            "event_types": list(EVENT_TYPES),
            "state_topic": names.topic(EVENT),
        },
        ROTATE: {
            "platform": "button",
            "name": "Change mask",
            "icon": "mdi:autorenew",
            "command_topic": names.topic(ROTATE),
            "payload_press": PRESS,
        },
        OFF: {
            "platform": "button",
            "name": "Stop looking",
            "icon": "mdi:eye-off-outline",
            "command_topic": names.topic(OFF),
            "payload_press": PRESS,
        },
    }
