"""A sync and an async camera over a mock transport."""

from __future__ import annotations

import inspect
import threading
from collections.abc import Callable
from typing import Any

import httpx
import pytest
from tests.unit.client.conftest import Daemon

from veilcam_client import Camera


class Both:
    """One call made through the sync and the async camera, with the waits it made."""

    def __init__(self, daemon: Daemon) -> None:
        self.daemon, self.waits = daemon, list[float]()

    async def __call__(self, kind: type, ask: Callable[[Any], Any], **options: Any) -> Any:
        transport = httpx.MockTransport(self.daemon)
        client = (
            httpx.Client(transport=transport)
            if kind is Camera
            else httpx.AsyncClient(transport=transport)
        )
        url = options.pop("url", "http://camera.local:1")
        camera = kind(url, http_client=client, **options)
        answer = ask(camera)
        return await answer if inspect.isawaitable(answer) else answer


@pytest.fixture
def both(daemon: Daemon, monkeypatch: pytest.MonkeyPatch) -> Both:
    made = Both(daemon)

    async def rest(seconds: float) -> None:
        made.waits.append(seconds)

    monkeypatch.setattr("veilcam_client.http.async_transport.asyncio.sleep", rest)

    class Closed(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            made.waits.append(timeout or 0.0)
            return self.is_set()

    monkeypatch.setattr("veilcam_client.http.streams.threading.Event", Closed)
    # Bound as a default argument when the module was loaded.
    monkeypatch.setattr(
        "veilcam_client.http.transport.Transport.__init__.__defaults__", (None, made.waits.append)
    )
    return made
