"""Requests that a page makes a browser send, and that do what they say when a program does."""

from __future__ import annotations

import dataclasses
import io
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import httpx
from PIL import Image

from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE
from veilcam_server.demo_data import BUNDLE
from veilcam_training.bundle import read_bundle, write_bundle

JSON = "application/json"


@dataclass(frozen=True, slots=True)
class Ask:
    """One request; ``way`` is how the page makes the browser send it, as page.html names it."""

    way: str
    method: str
    path: str
    body: bytes = b""
    media_type: str = JSON

    @property
    def name(self) -> str:
        return re.sub(r"[^A-Za-z]+", "-", f"{self.way} {self.method} {self.path}")

    def for_page(self, url: str) -> dict[str, Any]:
        return {
            "name": self.name,
            "way": self.way,
            "method": self.method,
            "url": url + self.path,
            "media_type": self.media_type,
        }

    def by_program(self, client: httpx.Client) -> bool:
        """Send it as a program does, without ``Origin``; whether it is done or answered."""
        headers = {"Content-Type": self.media_type} if self.body else {}
        if self.way == "WebSocket":
            headers |= {"Connection": "Upgrade", "Upgrade": "websocket"}
        with client.stream(
            self.method, self.path, content=self.body or None, headers=headers
        ) as answer:
            return answer.is_success


def _json(**fields: object) -> bytes:
    return json.dumps(fields).encode()


@cache
def _bundle() -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "other.veilcam"
        write_bundle(path, dataclasses.replace(read_bundle(BUNDLE), task="other"))
        return path.read_bytes()


def _picture() -> bytes:
    stream = io.BytesIO()
    Image.new("L", (28, 28), 200).save(stream, "PNG")
    return stream.getvalue()


def asks() -> Mapping[str, Ask]:
    receiver = str(ReceiverKey.generate().public)
    made = (
        Ask("fetch", "GET", "/v1/status"),
        Ask("fetch no-cors", "GET", "/v1/diagnostics"),
        Ask("fetch no-cors", "POST", "/v1/captures"),
        Ask("fetch", "POST", "/v1/rotation/advance"),
        Ask("fetch text/plain", "POST", "/v1/lease", _json(owner="a page", seconds=60)),
        Ask("fetch text/plain", "POST", "/v1/bundles", _bundle(), BUNDLE_MEDIA_TYPE),
        Ask("fetch text/plain", "POST", "/v1/receivers", _json(label="a page", key=receiver)),
        Ask("fetch with its type", "PUT", "/v1/rotation", _json(mode="captures", captures=7)),
        Ask("fetch with its type", "PUT", "/v1/simulation/scene", _picture(), "image/png"),
        Ask("fetch with its type", "DELETE", "/v1/simulation/scene"),
        Ask("form urlencoded", "POST", "/v1/rotation/advance"),
        Ask("form multipart", "POST", "/v1/captures"),
        Ask("form text/plain", "POST", "/v1/lease", b'{"owner": "=", "seconds": 60}'),
        Ask("beacon", "POST", "/v1/classifications"),
        Ask("image", "GET", "/v1/status"),
        Ask("script", "GET", "/v1/metrics"),
        Ask("frame", "GET", "/v1/bundles"),
        Ask("window", "GET", "/v1/rotation"),
        Ask("EventSource", "GET", "/v1/events"),
        Ask("WebSocket", "GET", "/v1/events"),
        # The last, since it takes a while, and nothing else is done meanwhile.
        Ask("fetch with its type", "POST", "/v1/calibration", _json(repeats=2)),
    )
    return {ask.name: ask for ask in made}
