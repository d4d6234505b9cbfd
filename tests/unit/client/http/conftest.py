"""A sync and an async camera over a mock transport."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest
from tests.unit.client.conftest import Daemon, camera_of, result


class Both:
    """One call made through the sync or the async camera, with the waits it made."""

    def __init__(self, daemon: Daemon, kind: type) -> None:
        self.daemon, self.kind, self.waits = daemon, kind, list[float]()

    async def __call__(self, ask: Callable[[Any], Any], **options: Any) -> Any:
        given = {"kind": self.kind, "url": "http://camera.local:1", **options}
        return await result(ask(camera_of(handler=self.daemon, **given)))


@pytest.fixture
def both(daemon: Daemon, kind: type, monkeypatch: pytest.MonkeyPatch) -> Both:
    made = Both(daemon, kind)

    async def rest(seconds: float) -> None:
        made.waits.append(seconds)

    monkeypatch.setattr("asyncio.sleep", rest)
    monkeypatch.setattr("veilcam_client.http.transport.time.sleep", made.waits.append)

    class Closed(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            made.waits.append(timeout or 0.0)
            return self.is_set()

    monkeypatch.setattr("veilcam_client.http.ends.threading.Event", Closed)
    return made
