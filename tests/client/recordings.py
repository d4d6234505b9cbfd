"""A daemon that answers from memory, and recordings of it."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx

from veilcam_client import Camera

EPOCH = "9f86d081884c7d659a2feaa0c55ad015"
AT = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
EXPOSURE = {"started_after_shown_s": 0.104, "settle_s": 0.1, "duration_s": 0.01}
TIMING = {"queue_s": 0, "rotation_s": 0, "settle_s": 0, "capture_s": 0, "total_s": 0}
STATUS: dict[str, Any] = {
    "version": "0.1.0",
    "api_version": 1,
    "state": "ready",
    "uptime_s": 1.0,
    "captures": 0,
    "release": "white",
    "device": {"display": "ST7735R", "sensor": "IMX477", "simulated": False},
    "bundle": {
        "digest": "0f" * 32,
        "task": "mnist",
        "mode": "fresh",
        "labels": ["0", "1"],
        "embedding_shape": [2, 3],
        "pairs": 0,
    },
    "rotation": {
        "policy": {"mode": "captures", "captures": 1},
        "epoch": EPOCH,
        "captures": 0,
        "preparation": {"ready": True, "prepared": 1, "last_s": 0, "late": 0, "reused": 0},
    },
    "queue": {"waiting": 0, "limit": 8},
}


def answer(number: int) -> dict[str, Any]:
    """The capture of this number, as the API answers it."""
    return {
        "id": f"{number:016x}",
        "taken_at": (AT + timedelta(seconds=number)).isoformat(),
        "epoch": f"{number:032x}",
        "embedding": {
            "form": "white",
            "shape": [2, 3],
            "values": [number + k / 7 for k in range(6)],
        },
        "exposure": EXPOSURE,
        "timing": TIMING,
    }


VERDICT = {"label": "1", "confidence": 0.75, "scores": {"0": 0.25, "1": 0.75}}


class Daemon:
    """Answers so many captures, then 503."""

    def __init__(self, captures: int = 100, **status: Any) -> None:
        self.status, self.left, self.taken = {**STATUS, **status}, captures, 0

    def __call__(self, request: httpx.Request) -> httpx.Response:
        if request.url.path == "/v1/status":
            return httpx.Response(200, json=self.status)
        if self.taken == self.left:
            problem = {
                "type": "about:blank",
                "title": "The sensor failed",
                "status": 503,
                "detail": "the sensor failed",
                "instance": request.url.path,
                "code": "sensor_failed",
                "request_id": "1",
                "retryable": True,
            }
            headers = {"content-type": "application/problem+json"}
            return httpx.Response(503, content=json.dumps(problem), headers=headers)
        taken = answer(self.taken)
        self.taken += 1
        if request.url.path == "/v1/classifications":
            assert json.loads(request.content) == {"include_embedding": True}
            taken = {**taken, **VERDICT}
        return httpx.Response(200, json=taken)

    def camera(self) -> Camera:
        """An SDK that asks it."""
        http = httpx.Client(transport=httpx.MockTransport(self))
        return Camera("http://localhost", http_client=http, max_retries=0)
