"""The event log: order, resuming, gaps, heartbeats."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING

import pytest

from veilcam_client.wire.events import (
    Classified,
    Event,
    Gap,
    Gone,
    MaskChanged,
    Seen,
    WatchChanged,
)
from veilcam_client.wire.watch import Watching
from veilcam_server.service.events import EventLog, EventPublisher, History

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from tests.unit.server.conftest import Bench

pytestmark = pytest.mark.anyio


def fill(log: EventLog, *names: str) -> None:
    for name in names:
        log.publish(partial(MaskChanged, epoch=name))


async def take(stream: AsyncIterator[Event | None], count: int) -> list[Event]:
    taken: list[Event] = []
    async for event in stream:
        if event is not None:
            taken.append(event)
        if len(taken) == count:
            return taken
    return taken


def names(events: list[Event]) -> list[str]:
    return [event.epoch if isinstance(event, MaskChanged) else event.kind for event in events]


async def test_new_listener_hears_what_happens_from_now_on() -> None:
    log = EventLog()
    fill(log, "before")
    hearing = asyncio.create_task(take(log.follow(None, 1.0), 2))
    await asyncio.sleep(0)
    fill(log, "a", "b")
    assert names(await hearing) == ["a", "b"]


async def test_listener_that_comes_back_goes_on_where_it_stopped() -> None:
    log = EventLog()
    fill(log, "a", "b", "c")
    heard = await take(log.follow(f"{log._boot}-0", 1.0), 2)
    assert names(heard) == ["b", "c"]
    fill(log, "d")
    assert names(await take(log.follow(heard[-1].id, 1.0), 1)) == ["d"]


async def test_missed_events_are_told_and_counted() -> None:
    log = EventLog(capacity=3)
    fill(log, *"abcdefgh")
    heard = await take(log.follow(f"{log._boot}-1", 1.0), 4)
    assert names(heard) == ["gap", "f", "g", "h"]
    assert isinstance(heard[0], Gap)
    assert heard[0].missed == 3
    assert names(await take(log.follow(heard[0].id, 1.0), 3)) == ["f", "g", "h"]


async def test_listener_misses_nothing_from_then_on() -> None:
    log = EventLog()
    fill(log, "a")
    stream = log.follow(None, 1.0)
    fill(log, *"bc")
    assert names(await take(stream, 2)) == ["b", "c"]


async def test_slow_listener_is_told_what_it_missed() -> None:
    log = EventLog(capacity=2)
    stream = log.follow(None, 1.0)
    first = asyncio.ensure_future(anext(stream))
    await asyncio.sleep(0)
    fill(log, "a")
    assert await first is not None
    fill(log, *"bcdef")
    heard = await take(stream, 3)
    assert names(heard) == ["gap", "e", "f"]
    assert isinstance(heard[0], Gap)
    assert heard[0].missed == 3


@pytest.mark.parametrize("last", ["00000000-5", "nonsense", "", "-", "x-٣"])
async def test_id_of_another_boot_is_a_gap(last: str) -> None:
    log = EventLog()
    fill(log, "a")
    heard = await take(log.follow(last, 1.0), 2)
    assert isinstance(heard[0], Gap)
    assert heard[0].missed is None
    assert names(heard) == ["gap", "a"]


async def test_id_from_the_future_is_taken_as_the_last() -> None:
    log = EventLog()
    fill(log, "a")
    hearing = asyncio.create_task(take(log.follow(f"{log._boot}-99999999999999999999", 1.0), 1))
    await asyncio.sleep(0)
    fill(log, "b")
    assert names(await hearing) == ["b"]


async def test_silence_is_broken_by_heartbeats() -> None:
    log = EventLog()
    stream = log.follow(None, 0.01)
    assert await anext(stream) is None
    fill(log, "a")
    assert names(await take(stream, 1)) == ["a"]


async def test_closing_ends_every_stream() -> None:
    log = EventLog()
    hearing = [asyncio.create_task(take(log.follow(None, 60.0), 1)) for _ in range(3)]
    await asyncio.sleep(0)
    log.close()
    assert await asyncio.gather(*hearing) == [[], [], []]


async def test_service_tells_what_it_does(bench: Bench) -> None:
    service = bench.service(bench.camera())
    async with service.open():
        stream = service.events(None)
        hearing = asyncio.create_task(take(stream, 4))
        await asyncio.sleep(0.01)
        result = await service.classify(include_embedding=False)
        await service.rotate()
        await service.set_policy(service.rotation().policy)
        heard = await hearing
    assert [event.kind for event in heard] == ["capture", "classification", "mask", "rotation"]
    numbers = [int(event.id.partition("-")[2]) for event in heard]
    assert numbers == list(range(numbers[0], numbers[0] + 4))
    assert getattr(heard[1], "label", None) == result.label
    assert getattr(heard[2], "epoch", None) == bench.epochs[-1]


async def test_subscribers_hear_what_is_published_from_whatever_thread() -> None:
    publisher = EventPublisher()
    heard: list[Event] = []
    publisher.subscribe(heard.append)
    publisher.publish(partial(MaskChanged, epoch="before"))
    with publisher.open():
        publisher.publish(partial(MaskChanged, epoch="a"))
        # On the loop's own thread nobody waits: what is answered next already counts it.
        assert names(heard) == ["a"]
        await asyncio.to_thread(publisher.publish, partial(MaskChanged, epoch="b"))
        assert names(heard) == ["a", "b"]
        followed = await take(publisher.log.follow(heard[0].id, 1.0), 1)
    publisher.publish(partial(MaskChanged, epoch="after"))
    assert names(heard) == ["a", "b"]
    assert names(followed) == ["b"]


async def test_public_events_tell_nothing_of_what_is_seen() -> None:
    publisher, history = EventPublisher(), History()
    publisher.subscribe(history.add)
    policy = Watching(rate_hz=2.0)
    watch = partial(WatchChanged, policy=policy)
    with publisher.open():
        for make in (
            partial(MaskChanged, epoch="a"),
            partial(Seen, label="x", confidence=None, duration_s=1.0),
            partial(watch, activity="waiting", detail="the light changed"),
            partial(watch, activity="looking"),
            partial(Gone, label="x", confidence=None, duration_s=1.0, reason="left"),
            partial(Classified, capture="c", epoch="a", label="x"),
            partial(watch, activity="quiet"),
            partial(watch, activity="looking"),
        ):
            publisher.publish(make)
        every = await take(publisher.log.follow("", 1.0), 9)
        public = await take(publisher.public.follow("", 1.0), 4)
    assert [event.kind for event in every[1:]] == [
        *("mask", "seen", "watch", "watch", "gone", "classification", "watch", "watch"),
    ]
    assert [getattr(event, "activity", event.kind) for event in public] == [
        *("gap", "mask", "quiet", "looking"),
    ]
    assert [event.id.rpartition("-")[2] for event in public] == ["0", "0", "1", "2"]
    assert history.events == {"mask": 1, "classification": 1}
