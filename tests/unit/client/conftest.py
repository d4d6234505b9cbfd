"""Answers of a daemon, without a daemon."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, TypeAlias

import httpx
import pytest

ROTATION = {
    "policy": {"mode": "captures", "captures": 3},
    "epoch": "e1",
    "captures": 2,
    "preparation": {"ready": True, "prepared": 4, "last_s": 0.1, "late": 0, "reused": 0},
}
WATCH = {
    "policy": {
        "mode": "watching",
        "rate_hz": 2.0,
        "quiet": {"begin": "22:00", "end": "07:00"},
    },
    "activity": "looking",
    "looks": 7200,
    "belief": {
        "label": "3",
        "confidence": 0.998,
        "since": "2026-01-02T03:04:05Z",
        "duration_s": 12.5,
        "looks": 25,
    },
    "history": [
        {
            "label": "3",
            "confidence": 0.998,
            "seen_at": "2026-01-02T03:04:05Z",
            "gone_at": None,
            "duration_s": 12.5,
        }
    ],
}
CAPTURE = {
    "id": "c1",
    "epoch": "e1",
    "number": 2,
    "taken_at": "2026-01-02T03:04:05Z",
    "embedding": {"form": "raw", "shape": [2, 3], "values": [0.0, 1.0, 2.0, 3.0, 4.0, 5.5]},
}
CLASSIFICATION = {
    "id": "c1",
    "epoch": "e1",
    "number": 2,
    "taken_at": "2026-01-02T03:04:05Z",
    "label": "7",
    "confidence": 0.9,
    "scores": {"7": 0.9, "1": 0.1},
    "embedding": None,
}
DEVICE = "d7" * 32
RECEIVER = {"id": "ab" * 32, "label": "archive", "added_at": "2026-01-02T03:04:05Z"}
RECEIVERS = {
    "device": DEVICE,
    "receivers": [
        RECEIVER,
        {"id": "abababab" + "cd" * 28, "label": "a tablet", "added_at": "2026-01-03T03:04:05Z"},
    ],
}
STATUS = {
    "version": "9.9",
    "api_version": 1,
    "state": "ready",
    "uptime_s": 3.0,
    "captures": 5,
    "release": "raw",
    "raw_budget": 100,
    "receivers": [RECEIVER],
    "device": {"display": "ST7735R", "sensor": "IMX477", "simulated": False, "key": DEVICE},
    "bundle": {
        "digest": "0" * 64,
        "task": "mnist",
        "mode": "pairs",
        "labels": ["7", "1"],
        "embedding_shape": [2, 3],
        "pairs": 5,
    },
    "rotation": ROTATION,
    "queue": {"waiting": 0, "limit": 8},
    "from_the_future": True,
}
LEASE = {"held": True, "owner": "me", "expires_in_s": 9.5, "mine": True}
TOKEN = {
    "id": "0123456789ab",
    "label": "a lamp",
    "scopes": ["classify", "read:status"],
    "created_at": "2026-01-02T03:04:05Z",
    "expires_at": None,
    "revoked_at": None,
    "last_used_on": "2026-01-03",
}
SECRET = "vc_0123456789ab_" + 64 * "5"
DIAGNOSTICS = {
    "versions": {"veilcam": "9.9"},
    "settings": {"queue_limit": 8, "bundle": "given"},
    "states": [{"at": "2026-01-02T03:04:05Z", "state": "ready", "detail": None}],
    "faults": [{"at": "2026-01-02T03:04:06Z", "code": "sensor_failed", "detail": "no frame came"}],
    "events": {"capture": 5},
    "fault_counts": {"sensor_failed": 1},
    "audit_lost": 0,
}
BUNDLE: dict[str, Any] = {
    "digest": "ab" * 32,
    "size": 2_300_000,
    "active": False,
    "configured": False,
    "bundle": {
        "digest": "ab" * 32,
        "task": "fashion",
        "mode": "pairs",
        "labels": ["7", "1"],
        "embedding_shape": [2, 3],
        "pairs": 5,
    },
}
BUNDLES: dict[str, list[dict[str, Any]]] = {
    "bundles": [
        {**BUNDLE, "digest": "cd" * 32, "active": True, "configured": True, "bundle": None},
        BUNDLE,
    ]
}
ANSWERS: dict[tuple[str, str], dict[str, Any]] = {
    ("GET", "/v1/bundles"): BUNDLES,
    ("POST", "/v1/bundles"): BUNDLE,
    ("POST", f"/v1/bundles/{'ab' * 32}/activate"): {**BUNDLE, "active": True},
    ("DELETE", f"/v1/bundles/{'ab' * 32}"): {"bundles": BUNDLES["bundles"][:1]},
    ("GET", "/v1/lease"): LEASE,
    ("POST", "/v1/lease"): {**LEASE, "secret": "5ec2e7"},
    ("DELETE", "/v1/lease"): {"held": False, "owner": None, "expires_in_s": None, "mine": False},
    ("GET", "/v1/diagnostics"): DIAGNOSTICS,
    ("GET", "/v1/tokens"): {"tokens": [TOKEN], "next": None},
    ("POST", "/v1/tokens"): {**TOKEN, "secret": SECRET},
    ("DELETE", "/v1/tokens/0123456789ab"): {**TOKEN, "revoked_at": "2026-01-04T00:00:00Z"},
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
    body = {
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
    return httpx.Response(
        status,
        content=json.dumps(body),
        headers={"Content-Type": "application/problem+json", **headers},
    )


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


Problem: TypeAlias = Callable[..., httpx.Response]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture
def daemon() -> Daemon:
    return Daemon()


@pytest.fixture
def make_problem() -> Problem:
    return problem


@pytest.fixture
def answers() -> dict[str, Any]:
    return {
        "status": STATUS,
        "capture": CAPTURE,
        "classification": CLASSIFICATION,
        "token": TOKEN,
    }


@pytest.fixture
def url(daemon: Daemon, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    class Handler(BaseHTTPRequestHandler):
        def handle_one(self) -> None:
            length = int(self.headers.get("Content-Length", 0))
            request = httpx.Request(
                self.command, f"http://x{self.path}", content=self.rfile.read(length)
            )
            answer = daemon(request)
            self.send_response(answer.status_code)
            for name, value in answer.headers.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(answer.content)

        do_GET = do_POST = do_PUT = do_DELETE = handle_one  # noqa: N815 - the names http.server looks for

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    address = f"http://127.0.0.1:{server.server_port}"
    monkeypatch.setenv("VEILCAM_URL", address)
    yield address
    server.shutdown()
    server.server_close()
    thread.join()
