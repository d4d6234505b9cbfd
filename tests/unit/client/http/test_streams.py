"""Event streams over a mock transport, and over sockets that somebody closes."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from itertools import islice
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from tests.unit.client.conftest import problem
from tests.unit.client.http.conftest import Both

from veilcam_client import AsyncCamera, Camera, EventStream, VeilcamError
from veilcam_client.errors import AccessError, ApiError, ConnectError, ProtocolError
from veilcam_client.http.options import STREAM_SILENCE
from veilcam_client.wire.base import CALL_HEADER

pytestmark = pytest.mark.anyio


def events(*texts: str) -> httpx.Response:
    return httpx.Response(200, text="".join(texts), headers={"Content-Type": "text/event-stream"})


def event(number: int, kind: str = "mask") -> str:
    data = {"kind": kind, "id": f"b-{number}", "at": "2026-01-02T03:04:05Z", "epoch": f"e{number}"}
    return f": heartbeat\n\nevent: {kind}\nid: b-{number}\ndata: {json.dumps(data)}\n\n"


async def collect(
    camera: Any, count: int, last_event_id: str | None = "b-0", reconnect: bool = True
) -> list[str]:
    """Epochs of the next events, kinds and labels of others."""
    heard: list[Any] = []
    stream = camera.events(last_event_id=last_event_id, reconnect=reconnect)
    if isinstance(stream, EventStream):
        with stream:
            heard += list(islice(stream, count))
        assert list(stream) == []
    else:
        async with stream:
            heard += [await anext(stream) for _ in range(count)]
        assert [each async for each in stream] == []
    return [
        getattr(each, "epoch", f"{each.kind} {getattr(each, 'label', '')}".strip())
        for each in heard
    ]


async def test_broken_stream_goes_on_after_the_last_event(both: Both) -> None:
    both.daemon.first = [
        events(event(1), event(2)),
        httpx.ConnectError("restarting"),
        events(event(3), event(4, "of_the_future"), event(5)),
    ]
    assert await both(lambda camera: collect(camera, 4)) == ["e1", "e2", "e3", "e5"]
    resumed = [request.headers["last-event-id"] for request in both.daemon.requests]
    assert resumed == ["b-0", "b-2", "b-2"]


async def test_stream_that_never_was_is_an_error(both: Both) -> None:
    both.daemon.first = [httpx.ConnectError("gone")] * 9
    with pytest.raises(ConnectError):
        await both(lambda camera: collect(camera, 1))
    assert len(both.daemon.requests) == 3


async def test_pauses_of_a_stream_grow_and_stay_until_it_was_healthy(
    both: Both, monkeypatch: pytest.MonkeyPatch
) -> None:
    lasted = 0.0
    clock = SimpleNamespace(monotonic=lambda: lasted + sum(both.waits))
    monkeypatch.setattr("veilcam_client.http.resumption.time", clock)
    gone: list[httpx.Response | Exception] = [
        *[httpx.ConnectError("gone")] * 40,
        httpx.Response(502, text="Bad Gateway"),
        httpx.ReadTimeout("slow"),
    ]
    # It is there again, and each stream ends with its first event.
    flapping = [events(event(n)) for n in range(10)]
    both.daemon.first = [events(event(1)), *gone, *flapping, events(event(2)), events(event(3))]

    async def follow(camera: Any) -> None:
        nonlocal lasted
        stream = camera.events()
        for heard in range(13):
            await anext(stream) if isinstance(camera, AsyncCamera) else next(stream)
            # Of the first and of the last but one: longer than any pause.
            lasted += 60.0 if heard in (0, 11) else 0.0
        closed = stream.close()
        if closed is not None:
            await closed

    await both(follow, max_retries=0)
    *pauses, last = both.waits
    assert len(pauses) == 1 + len(gone) + len(flapping)
    grown = [min(30.0, 0.25 * 2**n) for n in range(len(pauses))]
    assert all(most / 2 <= pause <= most for pause, most in zip(pauses, grown, strict=True))
    assert last <= 0.25
    # Once they have grown, less than six in a minute.
    assert min(sum(pauses[n : n + 5]) for n in range(8, len(pauses) - 4)) > 60


async def test_silence_of_a_stream_is_not_health(
    both: Both, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Silent(httpx.SyncByteStream, httpx.AsyncByteStream):
        def __iter__(self) -> Iterator[bytes]:
            both.waits.append(STREAM_SILENCE)
            raise httpx.ReadTimeout("silent")

        async def __aiter__(self) -> AsyncIterator[bytes]:
            for piece in self:
                yield piece

    clock = SimpleNamespace(monotonic=lambda: sum(both.waits))
    monkeypatch.setattr("veilcam_client.http.resumption.time", clock)
    both.daemon.first = [events(event(0)), events(event(1), event(2))]
    headers = {"Content-Type": "text/event-stream"}
    both.daemon.first[1:1] = [
        httpx.Response(200, stream=Silent(), headers=headers) for _ in range(9)
    ]
    assert await both(lambda camera: collect(camera, 3)) == ["e0", "e1", "e2"]
    pauses = [pause for pause in both.waits if pause != STREAM_SILENCE]
    assert pauses[-1] >= 15


async def test_stream_that_shall_not_come_back_says_what_broke_it(both: Both) -> None:
    both.daemon.first = [httpx.ConnectError("gone"), events(event(1))]
    with pytest.raises(ConnectError, match="ended the stream"):
        await both(lambda camera: collect(camera, 2, reconnect=False))
    assert len(both.daemon.requests) == 2


async def test_events_that_a_daemon_cannot_know_of_are_a_gap(both: Both) -> None:
    both.daemon.first = [events(": veilcam events\n\n"), events(), events(event(1)), events()]
    both.daemon.first.append(events(event(2)))
    heard = await both(lambda camera: collect(camera, 4, None))
    assert heard == ["gap", "gap", "e1", "e2"]
    resumed = [request.headers.get("last-event-id") for request in both.daemon.requests]
    assert resumed == [None, None, None, "b-1", "b-1"]


def foreign() -> httpx.Response:
    answer = events(event(2))
    answer.headers[CALL_HEADER] = "0" * 32
    return answer


@pytest.mark.parametrize(
    ("answer", "error", "why"),
    [
        (lambda: problem(401, "unauthorized"), AccessError, "went wrong"),
        (lambda: problem(422, "invalid_request"), ApiError, "went wrong"),
        (lambda: events("event: mask\ndata: {}\n\n"), ProtocolError, "update veilcam"),
        (foreign, ProtocolError, "answer to another request"),
    ],
)
@pytest.mark.parametrize("first", [[], [event(1)]], ids=["new", "resumed"])
async def test_refused_stream_says_why(
    both: Both,
    answer: Callable[[], httpx.Response],
    error: type[VeilcamError],
    why: str,
    first: list[str],
) -> None:
    both.daemon.first = [*(events(each) for each in first), answer()]
    with pytest.raises(error, match=why):
        await both(lambda camera: collect(camera, 2))
    named = [request.headers[CALL_HEADER] for request in both.daemon.requests]
    assert len(set(named)) == len(named) == 1 + len(first)


@pytest.fixture
def quiet() -> Iterator[tuple[str, threading.Event]]:
    """URL of a stream on which nothing happens, and whether somebody listens."""
    listened = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def stream() -> None:
            peer, _ = listener.accept()
            with peer:
                peer.recv(4096)
                peer.sendall(
                    b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\n\r\n: hello\n\n"
                )
                listened.set()
                peer.recv(4096)  # until the client hangs up

        thread = threading.Thread(target=stream)
        thread.start()
        yield f"http://127.0.0.1:{listener.getsockname()[1]}", listened
        thread.join()


def test_stream_may_be_closed_by_another_thread(quiet: tuple[str, threading.Event]) -> None:
    url, listened = quiet
    with Camera(url) as camera, camera.events() as stream:
        heard: list[object] = []
        listener = threading.Thread(target=lambda: heard.extend(stream))
        listener.start()
        assert listened.wait(300)
        stream.close()
        listener.join(30)
        assert not listener.is_alive()
        assert heard == []


async def test_stream_may_be_closed_by_another_task(quiet: tuple[str, threading.Event]) -> None:
    url, listened = quiet
    async with AsyncCamera(url) as camera:
        stream = camera.events()

        async def listen() -> list[object]:
            return [event async for event in stream]

        task = asyncio.create_task(listen())
        await asyncio.to_thread(listened.wait, 30)
        await stream.close()
        assert await task == []


def state(label: str | None, seconds: float = 1.0, *, looking: bool = True) -> str:
    """One state of a camera that looks by itself, with its padding."""
    at = "2026-01-02T03:04:05Z"
    belief = {"label": label, "since": at, "duration_s": seconds, "looks": 1, "confidence": 0.9}
    there = {"label": label, "seen_at": at, "gone_at": None, "duration_s": seconds}
    data = {
        "kind": "belief",
        "id": "",
        "at": at,
        "belief": belief if looking else None,
        "sighting": None if label is None else {**there, "confidence": 0.9},
    }
    return f":{' ' * 300}\nevent: belief\ndata: {json.dumps(data)}\n\n"


async def test_states_become_arrivals_and_departures(both: Both) -> None:
    both.daemon.first = [
        events(
            *(state("a"), state("a", 2.0), state("a", 3.0), event(1), state(None), state(None)),
            *(state("a"), state("b", 1.5), state("b", 0.5)),
        ),
        # What was missed between two connections is told, too.
        events(state("c", 9.0), state(None, looking=False), event(2)),
    ]
    assert await both(lambda camera: collect(camera, 11)) == [
        *("e1", "gone a", "seen a", "gone a", "seen b", "gone b", "seen b"),
        *("gone b", "seen c", "gone c", "e2"),
    ]
