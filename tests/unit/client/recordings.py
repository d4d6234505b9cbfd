"""A daemon that answers from memory, and recordings of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx

from veilcam_client import Camera
from veilcam_client.wire.status import example_status

AT = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
STATUS: dict[str, Any] = {
    **json.loads(example_status().model_dump_json()),
    "captures": 0,
    "release": "raw",
    "receivers": [],
}
STATUS["bundle"] = {**STATUS["bundle"], "mode": "fresh", "pairs": 0, "card": None}


def answer(number: int) -> dict[str, Any]:
    return {
        "id": f"{number:016x}",
        "epoch": f"{number:032x}",
        "number": 0,
        "taken_at": (AT + timedelta(seconds=number)).isoformat(),
        "embedding": {
            "form": "raw",
            "shape": [2, 3],
            "values": [number + k / 8 for k in range(6)],
        },
    }


VERDICT: dict[str, Any] = {"label": "1", "confidence": 0.75, "scores": {"0": 0.25, "1": 0.75}}


class Daemon:
    """Answers so many captures, then 503."""

    def __init__(
        self, captures: int = 100, answers: Callable[[int], dict[str, Any]] = answer, **status: Any
    ) -> None:
        self.status, self.left, self.taken = {**STATUS, **status}, captures, 0
        self.answers, self.verdict = answers, VERDICT

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
        taken = self.answers(self.taken)
        self.taken += 1
        if request.url.path == "/v1/classifications":
            assert json.loads(request.content) == {"include_embedding": True}
            taken = {**taken, **self.verdict}
        return httpx.Response(200, json=taken)

    def camera(self, **options: Any) -> Camera:
        http = httpx.Client(transport=httpx.MockTransport(self))
        return Camera("http://localhost", http_client=http, max_retries=0, **options)
