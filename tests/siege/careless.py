"""A daemon that withstands nothing: it shows that every row of a siege can fail."""

from __future__ import annotations

import json
import secrets
import sys
import threading
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from veilcam_client.keys.receivers import Receiver
from veilcam_server.errors import StartError
from veilcam_server.settings import Settings

NAME = f"{__name__}:serve"
FIRST = "0" * 64
"""Digest of the bundle that it starts with."""
STREAMS = 3
NAMES = 3
"""Names of epochs that there are, so that whoever looks three times has seen each."""


class Careless(ThreadingHTTPServer):
    """Keeps everything in memory, names epochs by turns, and stops rotating when a disk is full."""

    daemon_threads = True

    def __init__(self, settings: Settings) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.settings, self.uploads = settings, threading.Lock()
        self.epoch = self.captures = self.streams = 0
        self.policy: Any = {"mode": "off"}
        self.bundles, self.tokens = {FIRST: True}, dict[str, None]()
        self.paired: list[str] = []
        threading.Thread(target=self._rotate, daemon=True).start()

    def _rotate(self) -> None:
        while True:
            time.sleep(0.1)
            self.epoch += 1
            (self.settings.state_dir / f"epoch-{self.epoch}").write_bytes(bytes(4096))


class Handler(BaseHTTPRequestHandler):
    server: Careless

    def do_GET(self) -> None:
        name = self.path.removeprefix("/v1/").partition("?")[0]
        if name == "events":
            self._stream()
            return
        rotation = {"policy": self.server.policy, "epoch": _name(self.server.epoch)}
        answers: dict[str, Any] = {
            "status": {"state": "ready", "captures": self.server.captures, "rotation": rotation},
            "rotation": rotation,
            "diagnostics": {"faults": []},
            "lease": {"held": False},
            "receivers": {"device": "", "receivers": [{"id": each} for each in self.server.paired]},
            "log": {"records": []},
            "calibration": {"signed": None, "run": {"stage": "done"}},
            "bundles": {
                "bundles": [
                    {"digest": name, "active": active, "bundle": {}, "configured": name == FIRST}
                    for name, active in list(self.server.bundles.items())
                ]
            },
            "tokens": {
                "tokens": [{"id": name, "revoked_at": None} for name in self.server.tokens],
                "next": None,
            },
        }
        self._answer(200 if name in answers else 404, answers.get(name))

    def do_POST(self) -> None:
        length = int(self.headers.get("Content-Length", 0))
        with self.server.uploads:
            body = self.rfile.read(length)
        digest = secrets.token_hex(32)
        if self.path == "/v1/bundles":
            self.server.bundles[digest] = False
        elif self.path.endswith("activate"):
            # One assignment: of two callers at once, one bundle is active all the same.
            self.server.bundles = {name: name in self.path for name in list(self.server.bundles)}
        elif self.path == "/v1/tokens":
            self.server.tokens[digest] = None
        elif self.path == "/v1/receivers":
            self.server.paired.append(Receiver.parse(json.loads(body)["key"]).id)
        else:
            self.server.captures += 1
        created = self.path in ("/v1/bundles", "/v1/receivers", "/v1/tokens")
        taken = {"epoch": _name(self.server.epoch), "number": 0, "taken_at": "2026-01-01T00:00:00Z"}
        embedding = {"form": "raw", "shape": [1], "values": [1.0]}
        answer = {"id": digest, "digest": digest, **taken, "embedding": embedding}
        self._answer(201 if created else 200, answer)

    def do_PUT(self) -> None:
        self.server.policy = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self._answer(200, {})

    def do_DELETE(self) -> None:
        self._answer(200, {})

    def log_message(self, *_: Any) -> None:
        sys.stderr.write(f"{self.path}\n")

    def _stream(self) -> None:
        if self.server.streams >= STREAMS:
            self._answer(429, {})
            return
        self.server.streams += 1
        self.send_response(200)
        self.end_headers()
        try:
            told = self.server.epoch
            while True:
                self.wfile.write(b"event: capture\n\n")
                for epoch in range(told + 1, self.server.epoch + 1):
                    data = f'{{"kind":"mask","epoch":"{_name(epoch)}"}}'
                    self.wfile.write(f"event: mask\ndata: {data}\n\n".encode())
                told = self.server.epoch
                time.sleep(0.1)
        except OSError:
            self.server.streams -= 1

    def _answer(self, status: int, body: Any) -> None:
        self.send_response(status)
        self.end_headers()
        self.wfile.write(json.dumps(body).encode())


def _name(epoch: int) -> str:
    return str(epoch % NAMES)


def serve(settings: Settings, on_listening: Callable[[str], None]) -> None:
    settings.state_dir.mkdir(parents=True, exist_ok=True)
    for path in settings.state_dir.iterdir():
        if path.stat().st_size == 0 and path.name.startswith("tokens"):
            raise StartError(f"{path} is empty")
    with Careless(settings) as server:
        on_listening(f"http://127.0.0.1:{server.server_port}")
        server.serve_forever()
