"""Answers of a daemon, without a daemon."""

from __future__ import annotations

import inspect
import json
import ssl
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.unit.client.sealing import Device

from veilcam_client import AsyncCamera, Camera
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire import bundles, lease, pairing, rotation, status, tokens, watch

EXAMPLES: dict[str, dict[str, Any]] = {
    type(each).__name__: each.model_dump(mode="json")
    for room in (bundles, lease, pairing, rotation, status, tokens, watch)
    for each in room.examples()
}
"""Answers by the name of their model, as the OpenAPI document has them."""
AT = "2026-01-02T03:04:05Z"
ROTATION = {**EXAMPLES["Rotation"], "policy": {"mode": "captures", "captures": 3}, "epoch": "e1"}
WATCH = EXAMPLES["Watch"]
TAKEN = {"id": "c1", "epoch": "e1", "number": 2, "taken_at": AT}
VALUES = {"form": "raw", "shape": [2, 3], "values": [0.0, 1.0, 2.0, 3.0, 4.0, 5.5]}
CAPTURE = {**TAKEN, "embedding": VALUES}
VERDICT = {"label": "7", "confidence": 0.9, "scores": {"7": 0.9, "1": 0.1}}
CLASSIFICATION = {**TAKEN, **VERDICT, "embedding": None}
DEVICE = "d7" * 32
RECEIVER = {"id": "ab" * 32, "label": "archive", "added_at": AT}
TABLET = {"id": "abababab" + "cd" * 28, "label": "a tablet", "added_at": AT}
RECEIVERS = {"device": DEVICE, "receivers": [RECEIVER, TABLET]}
INFO = {"digest": "ab" * 32, "task": "fashion", "pairs": 5, "version": 0, "labels": ["7", "1"]}
INFO = {**EXAMPLES["Status"]["bundle"], **INFO, "signed_by": None, "card": None}
BUNDLE: dict[str, Any] = {
    **EXAMPLES["InstalledBundle"],
    "digest": "ab" * 32,
    "size": 2_300_000,
    "active": False,
    "bundle": INFO,
}
ACTIVE = {**BUNDLE, "digest": "cd" * 32, "active": True, "configured": True, "bundle": None}
BUNDLES: dict[str, list[dict[str, Any]]] = {"bundles": [ACTIVE, BUNDLE]}
STATUS = {
    **EXAMPLES["Status"],
    "version": "9.9",
    "release": "raw",
    "raw_budget": 100,
    "receivers": [RECEIVER],
    "bundle": INFO,
    "rotation": ROTATION,
    "from_the_future": True,
}
LEASE = {**EXAMPLES["Lease"], "owner": "me", "expires_in_s": 9.5}
TOKEN = {**EXAMPLES["Token"], "label": "a lamp", "last_used_on": "2026-01-03"}
SECRET = "vc_0123456789ab_" + 64 * "5"
MEASURING: dict[str, Any] = {
    "stage": "measuring",
    "scene": "dark",
    "instruction": None,
    "exposures": 10,
    "total": 330,
    "detail": None,
}
ANSWERS: dict[tuple[str, str], dict[str, Any]] = {
    ("GET", "/v1/bundles"): BUNDLES,
    ("POST", "/v1/bundles"): BUNDLE,
    ("POST", f"/v1/bundles/{'ab' * 32}/activate"): {**BUNDLE, "active": True},
    ("DELETE", f"/v1/bundles/{'ab' * 32}"): {"bundles": [ACTIVE]},
    ("GET", "/v1/calibration"): {"signed": None, "run": MEASURING},
    ("POST", "/v1/calibration"): MEASURING,
    ("POST", "/v1/calibration/scene"): MEASURING,
    ("DELETE", "/v1/calibration"): {**MEASURING, "stage": "cancelled"},
    ("GET", "/v1/lease"): LEASE,
    ("POST", "/v1/lease"): {**LEASE, "secret": "5ec2e7"},
    ("DELETE", "/v1/lease"): {"held": False, "owner": None, "expires_in_s": None, "mine": False},
    ("GET", "/v1/diagnostics"): EXAMPLES["Diagnostics"],
    ("GET", "/v1/tokens"): {"tokens": [TOKEN], "next": None},
    ("POST", "/v1/tokens"): {**TOKEN, "secret": SECRET},
    ("DELETE", "/v1/tokens/0123456789ab"): {**TOKEN, "revoked_at": AT},
    ("GET", "/v1/log"): {"records": [], "next": None},
    ("POST", "/v1/pairing"): EXAMPLES["PairingOffer"],
    ("POST", "/v1/pairing/claim"): EXAMPLES["Paired"],
    ("GET", "/v1/receivers"): RECEIVERS,
    ("POST", "/v1/receivers"): RECEIVER,
    ("GET", "/v1/status"): STATUS,
    ("POST", "/v1/captures"): CAPTURE,
    ("POST", "/v1/classifications"): CLASSIFICATION,
    ("GET", "/v1/rotation"): ROTATION,
    ("PUT", "/v1/rotation"): ROTATION,
    ("POST", "/v1/rotation/advance"): ROTATION,
    ("PUT", "/v1/simulation/scene"): {"scene": 1},
    ("DELETE", "/v1/simulation/scene"): {"scene": 2},
    ("GET", "/v1/watch"): WATCH,
    ("PUT", "/v1/watch"): WATCH,
}


def problem(status: int, code: str, *, retryable: bool = False, **headers: str) -> httpx.Response:
    told = {
        "type": f"urn:veilcam:problem:{code}",
        "title": "A title",
        "status": status,
        "detail": f"what went wrong: {code}",
        "instance": "/v1/captures",
        "code": code,
        "request_id": "r1",
        "retryable": retryable,
        "errors": [{"location": "body.seconds", "message": "too small"}],
    }
    media = {"Content-Type": "application/problem+json"}
    return httpx.Response(status, content=json.dumps(told), headers={**media, **headers})


def events(*told: dict[str, Any]) -> httpx.Response:
    return httpx.Response(
        200,
        text="".join(
            f"event: {each['kind']}\ndata: {json.dumps({'id': f'b-{n}', 'at': AT, **each})}\n\n"
            for n, each in enumerate(told)
        ),
        headers={"Content-Type": "text/event-stream"},
    )


def camera_of(kind: type, handler: Callable[[httpx.Request], Any], **options: Any) -> Any:
    client = httpx.Client if kind is Camera else httpx.AsyncClient
    return kind(http_client=client(transport=httpx.MockTransport(handler)), **options)


async def result(answer: Any) -> Any:
    return await answer if inspect.isawaitable(answer) else answer


class Daemon:
    """Answers every route; ``first`` are answers or errors to give before that."""

    def __init__(self) -> None:
        self.first: list[httpx.Response | Exception] = []
        self.requests: list[httpx.Request] = []

    def __call__(self, request: httpx.Request) -> httpx.Response:
        self.requests.append(request)
        if self.first:
            answer = self.first.pop(0)
            if isinstance(answer, Exception):
                raise answer
            return answer
        if request.method == "DELETE" and request.url.path == f"/v1/receivers/{'ab' * 32}":
            return httpx.Response(204)
        return httpx.Response(200, json=ANSWERS[request.method, request.url.path])


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture(autouse=True)
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's folder of settings, which has no profile."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    return tmp_path / "settings" / "veilcam"


@pytest.fixture(params=[Camera, AsyncCamera])
def kind(request: pytest.FixtureRequest) -> type:
    found: type = request.param
    return found


@pytest.fixture
def daemon() -> Daemon:
    return Daemon()


@pytest.fixture
def device() -> Device:
    return Device()


@pytest.fixture(scope="session")
def receiver() -> ReceiverKey:
    return ReceiverKey.generate()


class Handler(BaseHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def serving(handler: type[Handler], tls: ssl.SSLContext | None = None) -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    if tls is not None:
        server.socket = tls.wrap_socket(server.socket, server_side=True)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    yield f"{'http' if tls is None else 'https'}://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()
    thread.join()


def handler_of(daemon: Daemon) -> type[Handler]:
    """Return what serves the answers of a daemon over HTTP."""

    class Asked(Handler):
        def handle_one(self) -> None:
            length = int(self.headers.get("Content-Length", 0))
            content, headers = self.rfile.read(length), dict(self.headers)
            asked = httpx.Request(
                self.command, f"http://x{self.path}", content=content, headers=headers
            )
            answer = daemon(asked)
            self.send_response(answer.status_code)
            for name, value in answer.headers.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(answer.content)

        do_GET = do_POST = do_PUT = do_DELETE = handle_one  # noqa: N815 - the names http.server looks for

    return Asked


@pytest.fixture
def url(daemon: Daemon, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    with serving(handler_of(daemon)) as address:
        monkeypatch.setenv("VEILCAM_URL", address)
        yield address
