"""A house for a bridge: a real broker, somebody who listens to it, and a daemon that is told what
to say.
"""

from __future__ import annotations

import json
import queue
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion

from veilcam_client.wire.status import example_status
from veilcam_client.wire.watch import Belief, Watch, Watching

MOSQUITTO = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
NODE = "camera"
PATIENCE = 90.0
"""Longest wait for what takes milliseconds on a quiet machine [s]."""


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return int(taken.getsockname()[1])


def until(reached: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + PATIENCE
    while not reached():
        assert time.monotonic() < end, f"still not so: {what}"
        time.sleep(0.01)


class Mosquitto:
    """Debian's broker on a port of its own, which forgets all when it is killed."""

    def __init__(self, folder: Path, *lines: str) -> None:
        self.port = free_port()
        self._config = folder / "mosquitto.conf"
        listener = f"listener {self.port} 127.0.0.1"
        told = (listener, "persistence false", "log_type error", *lines)
        self._config.write_text("\n".join(told))
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        assert MOSQUITTO is not None
        self._process = subprocess.Popen([MOSQUITTO, "-c", str(self._config)])
        until(self._listens, "the broker listens")

    def _listens(self) -> bool:
        with suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
            return True
        return False

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()


@dataclass(frozen=True)
class Heard:
    """A message, whether the broker had kept it, and when it came [s since 1970]."""

    topic: str
    payload: str
    kept: bool
    at: float


class House:
    def __init__(self, port: int) -> None:
        self.now: dict[str, str] = {}
        """The last message of each topic."""
        self.heard: list[Heard] = []
        self.port = port
        self._client = paho.Client(CallbackAPIVersion.VERSION2)
        self.subscribed = 0
        self._client.on_connect = lambda client, *_: client.subscribe("#", 1)
        self._client.on_subscribe = self._on_subscribe
        self._client.on_message = self._on_message
        self._client.reconnect_delay_set(1, 1)
        self._client.connect_async("127.0.0.1", port)
        self._client.loop_start()
        until(self.listens, "the house listens")

    def listens(self) -> bool:
        return self.subscribed > 0

    def _on_subscribe(self, *_: object) -> None:
        self.subscribed += 1

    def _on_message(self, _: object, __: object, message: paho.MQTTMessage) -> None:
        payload = message.payload.decode()
        self.now[message.topic] = payload
        self.heard.append(Heard(message.topic, payload, message.retain, time.time()))

    def publish(self, topic: str, payload: str, *, retain: bool = False) -> None:
        self._client.publish(topic, payload, 1, retain).wait_for_publish(PATIENCE)

    def says(self, topic: str, payload: str) -> None:
        path = f"veilcam/{NODE}/{topic}"
        until(lambda: self.now.get(path) == payload, f"{topic} {payload}, not {self.now.get(path)}")

    def tells(self, topic: str, document: object) -> None:
        path = f"veilcam/{NODE}/{topic}"
        until(lambda: json.loads(self.now.get(path, "null")) == document, f"{topic} {document}")

    @property
    def events(self) -> list[dict[str, Any]]:
        path = f"veilcam/{NODE}/event"
        return [json.loads(message.payload) for message in self.heard if message.topic == path]

    def forget(self) -> None:
        self.subscribed = 0
        self.now.clear()
        self.heard.clear()

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


class Daemon:
    """Answers what a bridge asks, and tells of the events that it is given."""

    def __init__(self) -> None:
        self.port = free_port()
        self.status: dict[str, Any] = json.loads(example_status().model_dump_json())
        self.watch = Watch(policy=Watching(rate_hz=2.0), activity="looking", looks=1)
        self.asked: list[tuple[str, str]] = []
        """Method and path of what changes something."""
        self._streams: list[queue.Queue[bytes | None]] = []
        self._count = 0
        self._server: ThreadingHTTPServer | None = None

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def believes(self, label: str | None, confidence: float | None = None) -> None:
        belief = Belief(
            label=label, confidence=confidence, since=datetime.now(UTC), duration_s=1.0, looks=2
        )
        self.watch = self.watch.model_copy(update={"belief": belief})

    def say(self, kind: str, **fields: Any) -> None:
        """Send an event to everybody who listens; who asks afterwards is told the same."""
        if kind == "state":
            self.status.update(fields)
        else:
            label = fields["label"] if kind == "seen" else None
            self.believes(label, fields["confidence"])
        self._count += 1
        event = {"id": f"b-{self._count}", "at": "2026-01-02T03:04:05Z", "kind": kind, **fields}
        for stream in self._streams:
            stream.put(f"event: {kind}\ndata: {json.dumps(event)}\n\n".encode())

    @property
    def listeners(self) -> int:
        return len(self._streams)

    def start(self) -> None:
        daemon = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                if self.path == "/v1/events":
                    self._stream()
                elif self.path == "/v1/status":
                    self._answer("application/json", json.dumps(daemon.status))
                else:
                    self._answer("application/json", daemon.watch.model_dump_json())

            def _change(self) -> None:
                self.rfile.read(int(self.headers.get("Content-Length", 0)))
                daemon.asked.append((self.command, self.path))
                rotation = json.dumps(daemon.status["rotation"])
                body = rotation if self.command == "POST" else daemon.watch.model_dump_json()
                self._answer("application/json", body)

            do_POST = do_PUT = _change  # noqa: N815 - the names http.server looks for

            def _answer(self, media_type: str, body: str) -> None:
                self.send_response(200)
                self.send_header("Content-Type", media_type)
                self.end_headers()
                self.wfile.write(body.encode())

            def _stream(self) -> None:
                self._answer("text/event-stream", ": hello\n\n")
                told: queue.Queue[bytes | None] = queue.Queue()
                daemon._streams.append(told)
                with suppress(OSError):
                    while (event := told.get()) is not None:
                        self.wfile.write(event)
                with suppress(ValueError):
                    daemon._streams.remove(told)

            def log_message(self, *_: object) -> None:
                pass

        class Server(ThreadingHTTPServer):
            daemon_threads = True
            block_on_close = False

        self._server = Server(("127.0.0.1", self.port), Handler)
        threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True).start()

    def kill(self) -> None:
        """End as a process does that is killed: every connection with it."""
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
            for stream in list(self._streams):
                stream.put(None)
            self._streams.clear()


@contextmanager
def bridge(daemon: Daemon, broker: Mosquitto, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run ``veilcam-mqtt`` as it is installed, in a process of its own."""
    command = [
        *(sys.executable, "-m", "veilcam_mqtt", "--url", daemon.url, "--name", NODE),
        *("--broker", f"mqtt://127.0.0.1:{broker.port}", *options),
    ]
    with subprocess.Popen(command, stderr=subprocess.PIPE) as process:
        try:
            yield process
        finally:
            process.terminate()
