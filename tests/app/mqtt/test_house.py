"""The bridge between a real broker and a daemon that goes and comes back."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("aiomqtt", reason="the extra 'mqtt' is not installed")

from tests.app.mqtt.rig import MOSQUITTO, NODE, Daemon, House, Mosquitto, bridge, until

if TYPE_CHECKING:
    import subprocess

pytestmark = pytest.mark.skipif(
    MOSQUITTO is None, reason="mosquitto is not here: apt install mosquitto"
)
CONFIG = f"homeassistant/device/{NODE}/config"


@pytest.fixture(scope="module")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Mosquitto]:
    made = Mosquitto(tmp_path_factory.mktemp("broker"), "allow_anonymous true")
    made.start()
    yield made
    made.kill()


@pytest.fixture(scope="module")
def house(broker: Mosquitto) -> Iterator[House]:
    made = House(broker.port)
    yield made
    made.close()


@pytest.fixture(scope="module")
def daemon() -> Iterator[Daemon]:
    made = Daemon()
    yield made
    made.kill()


Bridges = Callable[[], "subprocess.Popen[bytes]"]


@pytest.fixture(scope="module")
def bridges(daemon: Daemon, broker: Mosquitto, house: House) -> Iterator[Bridges]:
    # Somebody switched the camera off before it came.
    house.publish(f"veilcam/{NODE}/off", "PRESS", retain=True)
    with ExitStack() as stack:
        started: list[subprocess.Popen[bytes]] = []

        def running() -> subprocess.Popen[bytes]:
            if not started or started[-1].poll() is not None:
                daemon.kill()
                daemon.start()
                started.append(stack.enter_context(bridge(daemon, broker)))
            house.says("bridge", "online")
            until(lambda: daemon.listeners == 1, "the bridge listens")
            return started[-1]

        yield running


@pytest.fixture
def running(bridges: Bridges, daemon: Daemon, house: House) -> subprocess.Popen[bytes]:
    process = bridges()
    house.heard.clear()
    daemon.say("seen", label="3", confidence=0.876, duration_s=0.5)
    daemon.say("state", state="ready", detail=None, remedy=None)
    for topic, payload in (("label", "3"), ("confidence", "88"), ("health", "ready")):
        house.says(topic, payload)
    until(lambda: len(house.events) > 0, "the event came")
    house.heard.clear()
    return process


@pytest.mark.slow
@pytest.mark.usefixtures("running")
def test_house_is_told_what_is_the_case_and_what_changes(daemon: Daemon, house: House) -> None:
    assert json.loads(house.now[CONFIG])["device"]["identifiers"] == [NODE]
    assert house.now[f"veilcam/{NODE}/camera"] == "online"
    daemon.say("seen", label="7", confidence=0.991, duration_s=0.5)
    house.says("label", "7")
    house.says("confidence", "99")
    daemon.say("gone", label="7", confidence=0.9, duration_s=2.5, reason="left")
    house.says("label", "nothing")
    daemon.say("state", state="safe", detail="the panel is dark", remedy="check_panel_wiring")
    house.says("health", "safe")
    details = {"detail": "the panel is dark", "remedy": "check_panel_wiring"}
    house.tells("health_details", details)
    # Whoever comes later finds all of it but the events.
    late = House(house.port)
    late.says("health", "safe")
    late.says("bridge", "online")
    late.close()
    assert all(message.kept for message in late.heard)
    assert not late.events
    until(lambda: len(house.events) >= 2, "both events came")
    assert [(event["event_type"], event["label"]) for event in house.events] == [
        ("seen", "7"),
        ("gone", "7"),
    ]


@pytest.mark.slow
def test_broker_that_was_killed_is_told_all_of_it_again(
    running: subprocess.Popen[bytes], daemon: Daemon, broker: Mosquitto, house: House
) -> None:
    broker.kill()
    assert running.stderr is not None
    while b"broker: connected" in (line := running.stderr.readline()) or b"broker" not in line:
        pass
    daemon.say("seen", label="5", confidence=0.9, duration_s=0.5)
    # So that the house misses nothing of what the bridge says when the broker is back.
    running.send_signal(signal.SIGSTOP)
    house.forget()
    broker.start()
    until(house.listens, "the house listens again")
    running.send_signal(signal.SIGCONT)
    house.says("bridge", "online")
    house.says("camera", "online")
    house.says("label", "5")
    assert CONFIG in house.now
    # What was seen meanwhile is the past.
    daemon.say("seen", label="6", confidence=0.9, duration_s=0.5)
    house.says("label", "6")
    until(lambda: len(house.events) >= 1, "the event of what is seen now")
    assert [event["label"] for event in house.events] == ["6"]


@pytest.mark.slow
@pytest.mark.usefixtures("running")
def test_daemon_that_was_killed_is_away_and_then_there_again(daemon: Daemon, house: House) -> None:
    daemon.kill()
    house.says("camera", "offline")
    assert house.now[f"veilcam/{NODE}/bridge"] == "online"
    daemon.believes(None, 0.97)
    daemon.status["state"] = "degraded"
    daemon.start()
    house.says("camera", "online")
    house.says("label", "nothing")
    house.says("health", "degraded")
    until(lambda: daemon.listeners == 1, "the bridge listens again")
    daemon.say("seen", label="1", confidence=None, duration_s=0.5)
    house.says("label", "1")
    house.says("confidence", "None")


@pytest.mark.slow
@pytest.mark.usefixtures("running")
def test_home_assistant_is_told_all_of_it_when_it_comes_up(house: House) -> None:
    house.forget()
    house.publish("homeassistant/status", "offline")
    house.publish("homeassistant/status", "online")
    house.says("bridge", "online")
    house.says("camera", "online")
    assert CONFIG in house.now


@pytest.mark.slow
@pytest.mark.usefixtures("running")
def test_buttons_do_what_they_say_and_an_old_press_does_nothing(
    daemon: Daemon, house: House
) -> None:
    house.publish(f"veilcam/{NODE}/rotate", "press")
    house.publish(f"veilcam/{NODE}/rotate", "PRESS")
    until(lambda: len(daemon.asked) == 1, "the mask changes")
    house.publish(f"veilcam/{NODE}/off", "PRESS")
    until(lambda: len(daemon.asked) == 2, "the camera is switched off")
    assert daemon.asked == [("POST", "/v1/rotation/advance"), ("PUT", "/v1/watch")]


@pytest.mark.slow
def test_last_will_and_goodbye_say_the_same(bridges: Bridges, house: House) -> None:
    for end in ("terminate", "kill"):
        process = bridges()
        getattr(process, end)()
        house.says("bridge", "offline")
        process.wait()
        assert process.stderr is not None
        assert b"Traceback" not in process.stderr.read()
