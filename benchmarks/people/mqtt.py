"""How fast a house follows its camera over MQTT, and whether it is right again after all that dies.

    python -m benchmarks.people.mqtt --figures benchmarks/results/people.json

A simulated daemon looks by itself at digits that change; `veilcam-mqtt` and a real mosquitto run in
processes of their own on loopback, and this process listens to the broker. Measured are the times

- from an event `seen`, as the daemon dates it, to the label on the broker (a `gone` that a `seen`
  follows at once may change no label),
- from SIGKILL of the daemon to `offline` on the broker,
- from SIGKILL of the bridge to its last will,
- from the moment that a broker, or a daemon, that was killed listens again to the whole state on
  the broker; these two are told, and are no part of the figure, as the bridge pauses for up to 5 s
  before it tries again.

`mqtt_follow_ms` is the longest of the first three. The broker keeps nothing on a disk, so that one
that was killed has forgotten all.
"""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import cycle, islice
from pathlib import Path
from typing import Annotated

import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.rig import work_folder
from tests.app.mqtt.rig import NODE, House, Mosquitto, free_port, until

from veilcam_client import Camera
from veilcam_client.errors import ConnectError
from veilcam_client.events import Seen
from veilcam_server.demo_data import load_digits
from veilcam_server.devices.simulated.scenes import write_scene

PRESENTED = 3.0
"""How long a digit is shown [s]."""


def main(
    changes: Annotated[int, typer.Option(min=2, help="Digits that are shown.")] = 20,
    figures: FiguresOption = None,
) -> None:
    """Measure how fast a house follows its camera."""
    with work_folder() as folder:
        found = measured(folder, changes)
    for name, milliseconds in found.items():
        print(f"{name:<16} {milliseconds:8.1f} ms")
    worst = max(found["label"], found["daemon away"], found["bridge away"])
    record(figures, {"mqtt_follow_ms": round(worst, 1)})


def measured(folder: Path, changes: int) -> dict[str, float]:
    """The longest time of each kind [ms]."""
    port, broker = free_port(), Mosquitto(folder, "allow_anonymous true")
    broker.start()
    house = House(broker.port)
    found = {}
    try:
        with process(*bridge_of(port, broker.port)) as bridge:
            with process(*daemon_of(folder, port)) as daemon:
                answers(port)
                house.says("bridge", "online")
                found["label"] = labels(folder, house, port, changes)
                label = house.now[f"veilcam/{NODE}/label"]
                broker.kill()
                house.forget()
                found["broker back"] = timed(broker.start, lambda: house.says("label", label))
                found["daemon away"] = timed(daemon.kill, lambda: house.says("camera", "offline"))
            with process(*daemon_of(folder, port)):
                found["daemon back"] = timed(
                    lambda: answers(port), lambda: house.says("camera", "online")
                )
                found["bridge away"] = timed(bridge.kill, lambda: house.says("bridge", "offline"))
    finally:
        house.close()
        broker.kill()
    return found


def timed(happens: Callable[[], None], told: Callable[[], None]) -> float:
    """From the end of what happens until the house was told [ms]; 0 if it was told before."""
    happens()
    begun = time.monotonic()
    told()
    return 1e3 * (time.monotonic() - begun)


def labels(folder: Path, house: House, port: int, changes: int) -> float:
    """Show digits, and return the longest time from an event to the label on the broker [ms]."""
    sights: list[Seen] = []
    with Camera(f"http://127.0.0.1:{port}") as camera, camera.events() as events:

        def listen() -> None:
            sights.extend(event for event in events if isinstance(event, Seen))

        listener = threading.Thread(target=listen)
        listener.start()
        digits = load_digits()
        for kind in islice(cycle(range(10)), changes):
            index = next(n for n, label in enumerate(digits.labels) if label == kind)
            write_scene(folder / "scene.npy", digits.images[index])
            # Some digits are never recognised; the next one comes all the same.
            time.sleep(PRESENTED)
        events.close()
        listener.join()
    return max(delay(house, sight) for sight in sights)


def delay(house: House, sight: Seen) -> float:
    """From an event to the label that the house was told after it [ms]."""
    dated = sight.at.timestamp()
    came = [
        message.at
        for message in house.heard
        if message.topic.endswith("/label")
        and message.payload == sight.label
        and message.at >= dated
    ]
    return 1e3 * (min(came) - dated)


def answers(port: int) -> None:
    """Wait until the daemon answers."""
    with Camera(f"http://127.0.0.1:{port}", max_retries=0) as camera:

        def reached() -> bool:
            try:
                return camera.status().state == "ready"
            except ConnectError:
                return False

        until(reached, "the daemon answers")


def daemon_of(folder: Path, port: int) -> tuple[str, ...]:
    """Command of a simulated daemon that looks by itself."""
    scene = folder / "scene.npy"
    if not scene.exists():
        write_scene(scene, load_digits().images[0])
    return (
        *("veilcam_server", "serve", "--simulate", "--port", str(port), "--watch", "5/s"),
        *("--scenes", str(scene), "--state-dir", str(folder / "state"), "--log-level", "error"),
    )


def bridge_of(port: int, broker: int) -> tuple[str, ...]:
    """Command of the bridge between them."""
    return (
        *("veilcam_mqtt", "--url", f"http://127.0.0.1:{port}", "--name", NODE),
        *("--broker", f"mqtt://127.0.0.1:{broker}", "--log-level", "error"),
    )


@contextmanager
def process(*command: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a module of ours, and kill it in the end."""
    with subprocess.Popen([sys.executable, "-m", *command], stdout=subprocess.DEVNULL) as made:
        try:
            yield made
        finally:
            made.kill()


if __name__ == "__main__":
    typer.run(main)
