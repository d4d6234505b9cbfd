"""Does Home Assistant itself take what it is told of the device?

    python -m benchmarks.people.home_assistant

Installs Home Assistant into an environment of its own (630 MB, Python 3.13, some minutes) where
that is not there yet, and has its own schemas judge the discovery message of every camera that the
wire models have an example of, and messages that it must refuse. Ends with 0 if it judges all as it
should. `make test` checks the same against tests/unit/mqtt/discovery_schema.json instead.
"""

from __future__ import annotations

import copy
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from veilcam_client.wire.status import example_status
from veilcam_mqtt.discovery import discovery
from veilcam_mqtt.settings import Names

PACKAGES = ("homeassistant==2026.2.3", "paho-mqtt==2.1.0")
JUDGE = """
import json, sys
from homeassistant.components.mqtt import button, event, schemas, sensor
ENTITIES = {"button": button, "event": event, "sensor": sensor}
SHARED = ("device", "origin", "availability", "availability_mode", "qos")

def verdict(payload):
    try:
        # Twice: for the device as a whole, and as each entity is set up from it.
        schemas.MQTT_ORIGIN_INFO_SCHEMA(payload["origin"])
        schemas.DEVICE_DISCOVERY_SCHEMA(payload)
        for component in payload["components"].values():
            entity = {name: payload[name] for name in SHARED if name in payload} | component
            ENTITIES[entity.pop("platform")].DISCOVERY_SCHEMA(entity)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return None

print(json.dumps([verdict(payload) for payload in json.load(sys.stdin)]))
"""


def main(
    venv: Annotated[
        Path, typer.Option(help="Environment of Home Assistant, made where it is not there.")
    ] = Path("build/home-assistant"),
    python: Annotated[str, typer.Option(help="Python 3.13, to make it with.")] = "python3.13",
) -> None:
    """Have Home Assistant judge what it is told."""
    if not (venv / "bin" / "hass").exists():
        install(venv, python)
    good = [discovery(example_status(), Names("camera"))]
    bad = refused(good[0])
    verdicts = judged(venv, [*good, *bad.values()])
    names = [*(f"example {number}" for number in range(len(good))), *bad]
    wrong = 0
    for name, verdict in zip(names, verdicts, strict=True):
        said = "taken" if verdict is None else f"refused: {verdict}"
        right = (verdict is None) == (name not in bad)
        wrong += not right
        print(f"{'ok   ' if right else 'WRONG'} {name}: {said[:160]}")
    sys.exit(wrong > 0)


def install(venv: Path, python: str) -> None:
    """Make the environment; it wants a later Python 3.13 than it needs."""
    if shutil.which(python) is None:
        raise typer.BadParameter(f"{python} is not here: give a Python 3.13 with --python")
    subprocess.run([python, "-m", "venv", str(venv)], check=True)
    pip = [str(venv / "bin" / "pip"), "install", "--quiet", "--ignore-requires-python"]
    subprocess.run([*pip, *PACKAGES], check=True)


def refused(payload: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Messages that are wrong in one thing each, by what is wrong. None takes a field away."""
    changes: dict[str, tuple[str, dict[str, Any]]] = {
        "two kinds of availability": ("", {"availability_topic": "a"}),
        "a field that nobody knows": ("", {"expire_after": 5}),
        "an enum with a unit": ("label", {"unit_of_measurement": "%"}),
        "a duration in none": ("mask_age", {"unit_of_measurement": "parsec"}),
        "an event without types": ("event", {"event_types": None}),
        "a topic with a wildcard": ("rotate", {"command_topic": "a/#"}),
    }
    made = {}
    for name, (component, change) in changes.items():
        made[name] = copy.deepcopy(payload)
        changed = made[name]["components"][component] if component else made[name]
        changed.update(change)
        for field in [field for field, value in changed.items() if value is None]:
            del changed[field]
    return made


def judged(venv: Path, payloads: list[dict[str, Any]]) -> list[str | None]:
    """What Home Assistant has against each; None: nothing."""
    done = subprocess.run(
        [str(venv / "bin" / "python"), "-c", JUDGE],
        input=json.dumps(payloads),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    verdicts: list[str | None] = json.loads(done.stdout.splitlines()[-1])
    return verdicts


if __name__ == "__main__":
    typer.run(main)
