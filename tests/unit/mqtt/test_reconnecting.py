"""Cameras and brokers that answer and go at once: the bridge does not knock ever more often."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import httpx
import pytest
from tests.unit.client.conftest import ANSWERS

from veilcam_client import AsyncCamera

pytest.importorskip("aiomqtt", reason="the extra 'mqtt' is not installed")

from veilcam_mqtt import settings
from veilcam_mqtt.follower import Follower
from veilcam_mqtt.publisher import Publisher
from veilcam_mqtt.settings import Broker, Names

pytestmark = pytest.mark.anyio

GROWN = (0.0, 0.0, 0.0, 600.0)
"""Pauses, the last of which no test outlasts [s]."""


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


async def test_camera_whose_streams_end_at_once_is_followed_at_growing_pauses(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(settings, "PAUSES", GROWN)
    told, streams = asyncio.Event(), 0

    async def daemon(request: httpx.Request) -> httpx.Response:
        nonlocal streams
        if request.url.path != "/v1/events":
            return httpx.Response(200, json=ANSWERS[request.method, request.url.path])
        # Known and well: only the stream does not last.
        await told.wait()
        told.clear()
        streams += 1
        return httpx.Response(200, headers={"Content-Type": "text/event-stream"})

    client = httpx.AsyncClient(transport=httpx.MockTransport(daemon))
    camera = AsyncCamera("http://localhost", http_client=client, max_retries=0)
    following = Follower(camera, lambda view: told.set() if view.online else None, lambda _: None)
    await _settled(asyncio.create_task(following.run()), lambda: streams)
    assert streams == len(GROWN)


async def test_broker_that_ends_every_connection_is_reached_at_growing_pauses(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(settings, "PAUSES", GROWN)
    connections = 0

    async def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal connections
        await reader.read(1)
        connections += 1
        writer.write(b"\x20\x02\x00\x00")  # CONNACK: accepted (MQTT 3.1.1, 3.2)
        await writer.drain()
        writer.close()

    # One error of paho-mqtt that nobody waits for comes with each broker that goes.
    asyncio.get_running_loop().set_exception_handler(lambda *_: None)
    async with await asyncio.start_server(accept, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        telling = Publisher(Broker(f"mqtt://127.0.0.1:{port}"), Names("camera"), lambda _: None)
        await _settled(asyncio.create_task(telling.run()), lambda: connections)
    assert connections == len(GROWN)


async def _settled(task: asyncio.Task[None], count: Callable[[], int]) -> None:
    """Let a task reach its longest pause, or go far beyond it, and end it."""
    async with asyncio.timeout(60):
        while count() < len(GROWN):
            await asyncio.sleep(0.01)
    await asyncio.sleep(0.5)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
