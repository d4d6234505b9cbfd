"""The benchmark of the event stream, made short; and that it would notice a failure."""

from __future__ import annotations

import asyncio
import json
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from benchmarks.daemon import sse

from veilcam_client.http.sse import Decoder
from veilcam_client.wire.events import EVENT, Event, Gap, MaskChanged
from veilcam_server.api.app import create_app
from veilcam_server.service.events import CAPACITY

if TYPE_CHECKING:
    from starlette.types import Message
    from tests.unit.server.conftest import Bench

NOW = datetime.now(UTC)


def mask(place: int) -> Event:
    return MaskChanged(id=f"boot-{place}", at=NOW, epoch="e")


def gap(place: int, missed: int | None) -> Event:
    return Gap(id=f"boot-{place}", at=NOW, missed=missed)


@pytest.mark.parametrize(
    ("events", "told", "silent", "repeated"),
    [
        ([mask(3), mask(4), mask(5)], 0, 0, 0),
        ([mask(3), mask(6)], 0, 2, 0),
        ([mask(3), mask(4), mask(4), mask(5)], 0, 0, 1),
        ([mask(3), mask(5), mask(4)], 0, 1, 1),
        ([mask(3), gap(7, 4), mask(8)], 4, 0, 0),
        ([mask(3), gap(7, 2), mask(8)], 2, 2, 0),
        ([mask(3), gap(7, 4), mask(9)], 4, 1, 0),
    ],
)
def test_what_is_missed_or_repeated_is_counted(
    events: list[Event], told: int, silent: int, repeated: int
) -> None:
    heard = sse.Heard()
    for event in events:
        heard.hear(event)
    assert (heard.told, heard.silent, heard.repeated) == (told, silent, repeated)
    whole = sse.Heard()
    for place in range(3, 10):
        whole.hear(mask(place))
    assert sse.missing([whole]) == 0
    assert sse.missing([whole, heard]) >= told + silent + repeated


def test_a_listener_that_never_heard_the_end_is_counted() -> None:
    first, second = sse.Heard(), sse.Heard()
    for place in range(5):
        first.hear(mask(place))
    second.hear(mask(0))
    assert sse.missing([first, second]) == 1


@pytest.mark.anyio
async def test_who_does_not_read_slows_nobody_and_is_told_what_it_missed(bench: Bench) -> None:
    service = bench.service(bench.camera())
    app = create_app(service)
    gate, slow, fast = asyncio.Event(), bytearray(), bytearray()

    async def blocked(message: Message) -> None:
        await gate.wait()
        slow.extend(message.get("body", b""))

    async def free(message: Message) -> None:
        fast.extend(message.get("body", b""))

    async def receive() -> Message:
        await asyncio.Future[None]()
        raise AssertionError

    def heard(stream: bytes) -> list[Event]:
        messages = Decoder().feed(stream)
        return [EVENT.validate_json(message.data) for message in messages]

    async def until(stream: bytearray, first: int) -> list[Event]:
        while (f"-{first}\n").encode() not in stream:
            await asyncio.sleep(0.001)
        return heard(bytes(stream))

    scope = {
        "type": "http",
        "method": "GET",
        "path": "/v1/events",
        "raw_path": b"/v1/events",
        "query_string": b"",
        "headers": [(b"host", b"localhost")],
        "http_version": "1.1",
        "scheme": "http",
        "client": ("127.0.0.1", 1),
        "server": ("localhost", 80),
    }
    async with service.open():
        streams = [asyncio.create_task(app(dict(scope), receive, send)) for send in (blocked, free)]
        policy = service.rotation().policy
        while not fast:
            await asyncio.sleep(0.001)
        for place in range(CAPACITY + 500):
            await service.set_policy(policy)
            if place % 100 == 0:
                await until(fast, place)
        first = await until(fast, CAPACITY + 499)
        assert [event.kind for event in first] == ["rotation"] * (CAPACITY + 500)
        gate.set()
        second = await until(slow, CAPACITY + 499)
        service.end_streams()
        await asyncio.gather(*streams)
    gaps = [event for event in second if isinstance(event, Gap)]
    assert len(gaps) == 1
    assert gaps[0].missed is not None
    assert len(second) - 1 + gaps[0].missed == CAPACITY + 500
    assert gaps[0].missed > 400


@pytest.mark.thorough
def test_listeners_of_a_daemon_miss_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = tmp_path / "figures.json"
    sse.main(listeners=6, seconds=0.5, figures=figures)
    assert "who did not read: 0 missed" in capsys.readouterr().out
    assert json.loads(figures.read_text())["sse_gaps"]["value"] == 0
