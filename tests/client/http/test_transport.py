"""Cameras over a mock transport: requests, retries, errors, streams."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import httpx
import numpy as np
import pytest

from veilcam_client import (
    ApiError,
    AsyncCamera,
    BusyError,
    Camera,
    ConnectError,
    DeviceError,
    EverySeconds,
    InvalidRequestError,
    ProtocolError,
    RequestTimeoutError,
    RotationOff,
    ServerError,
    VeilcamError,
)
from veilcam_client.http.sse import Decoder, Message
from veilcam_client.http.transport import RetryPolicy

if TYPE_CHECKING:
    from tests.client.conftest import Daemon, Problem

pytestmark = pytest.mark.anyio


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
        camera = kind("http://camera.local:1", http_client=client, **options)
        answer = ask(camera)
        return await answer if inspect.isawaitable(answer) else answer


@pytest.fixture
def both(daemon: Daemon, monkeypatch: pytest.MonkeyPatch) -> Both:
    made = Both(daemon)

    async def rest(seconds: float) -> None:
        made.waits.append(seconds)

    monkeypatch.setattr("veilcam_client.http.transport.asyncio.sleep", rest)
    # Bound as a default argument when the module was loaded.
    monkeypatch.setattr(
        "veilcam_client.http.transport.Transport.__init__.__defaults__", (None, made.waits.append)
    )
    return made


KINDS = pytest.mark.parametrize("kind", [Camera, AsyncCamera])


@KINDS
async def test_every_method_asks_its_route(both: Both, kind: type) -> None:
    asks: list[tuple[Callable[[Any], Any], str, str, Any]] = [
        (lambda camera: camera.status(), "GET", "/v1/status", None),
        (lambda camera: camera.capture(), "POST", "/v1/captures", None),
        (lambda camera: camera.classify(), "POST", "/v1/classifications", None),
        (
            lambda camera: camera.classify(include_embedding=True),
            "POST",
            "/v1/classifications",
            {"include_embedding": True},
        ),
        (lambda camera: camera.rotation(), "GET", "/v1/rotation", None),
        (
            lambda camera: camera.set_rotation(EverySeconds(seconds=7)),
            "PUT",
            "/v1/rotation",
            {"mode": "seconds", "seconds": 7.0, "jitter": 0.0, "reuse": 0},
        ),
        (
            lambda camera: camera.set_rotation(RotationOff()),
            "PUT",
            "/v1/rotation",
            {"mode": "off"},
        ),
        (lambda camera: camera.rotate(), "POST", "/v1/rotation/advance", None),
        (lambda camera: camera.receivers(), "GET", "/v1/receivers", None),
        (
            lambda camera: camera.add_receiver("archive", "veilcam-receiver:c2VhbGVk"),
            "POST",
            "/v1/receivers",
            {"label": "archive", "key": "veilcam-receiver:c2VhbGVk"},
        ),
        (
            lambda camera: camera.remove_receiver("ab" * 32),
            "DELETE",
            f"/v1/receivers/{'ab' * 32}",
            None,
        ),
    ]
    for ask, method, path, body in asks:
        await both(kind, ask)
        request = both.daemon.requests[-1]
        assert (request.method, request.url.path) == (method, path)
        assert (json.loads(request.content) if request.content else None) == body
        assert ("idempotency-key" in request.headers) is (method == "POST")


@KINDS
async def test_results_are_typed(both: Both, kind: type) -> None:
    capture = await both(kind, lambda camera: camera.capture())
    assert np.asarray(capture).shape == (2, 3)
    result = await both(kind, lambda camera: camera.classify())
    assert (result.label, result.confidence) == ("7", 0.9)
    assert (await both(kind, lambda camera: camera.rotation())).policy.captures == 3
    receivers = await both(kind, lambda camera: camera.receivers())
    assert (receivers.device, len(receivers.receivers)) == ("d7" * 32, 2)
    assert await both(kind, lambda camera: camera.remove_receiver("ab" * 32)) is None


@KINDS
@pytest.mark.parametrize(
    "case",
    [
        (409, "rotation_impossible", InvalidRequestError),
        (422, "invalid_request", InvalidRequestError),
        (429, "queue_full", BusyError),
        (503, "sensor_failed", DeviceError),
        (500, "internal_error", ServerError),
    ],
)
async def test_a_problem_is_the_error_of_its_status(
    both: Both, kind: type, case: tuple[int, str, type[ApiError]], make_problem: Problem
) -> None:
    status, code, error = case
    both.daemon.first = [make_problem(status, code)]
    with pytest.raises(error) as caught:
        await both(kind, lambda camera: camera.capture())
    found = caught.value
    assert (found.code, found.status, found.request_id) == (code, status, "r1")
    assert not found.retryable
    assert found.errors[0].location == "body.seconds"
    assert str(found) == f"what went wrong: {code}"
    assert len(both.daemon.requests) == 1


@KINDS
async def test_what_may_succeed_later_is_repeated_with_the_same_key(
    both: Both, kind: type, make_problem: Problem
) -> None:
    both.daemon.first = [
        make_problem(503, "sensor_failed", retryable=True, **{"Retry-After": "3"}),
        httpx.ReadTimeout("slow"),
    ]
    assert (await both(kind, lambda camera: camera.capture())).id == "c1"
    keys = {request.headers["idempotency-key"] for request in both.daemon.requests}
    assert len(both.daemon.requests) == 3
    assert len(keys) == 1
    assert 3 <= both.waits[0] <= 3.25
    assert 0 <= both.waits[1] <= 0.5
    await both(kind, lambda camera: camera.capture())
    assert both.daemon.requests[-1].headers["idempotency-key"] not in keys


@KINDS
async def test_it_gives_up_after_the_retries_it_was_given(
    both: Both, kind: type, make_problem: Problem
) -> None:
    busy = make_problem(429, "queue_full", retryable=True)
    for retries in (0, 2, 4):
        both.daemon.first = [busy] * 5
        both.daemon.requests.clear()
        with pytest.raises(BusyError):
            await both(kind, lambda camera: camera.capture(), max_retries=retries)
        assert len(both.daemon.requests) == 1 + retries


@KINDS
async def test_a_wait_beyond_all_patience_is_not_waited(
    both: Both, kind: type, make_problem: Problem
) -> None:
    both.daemon.first = [make_problem(503, "x", retryable=True, **{"Retry-After": "3600"})]
    with pytest.raises(DeviceError) as caught:
        await both(kind, lambda camera: camera.capture())
    assert caught.value.retry_after == 3600
    assert both.waits == []


@KINDS
@pytest.mark.parametrize(
    ("raised", "error"),
    [
        (httpx.ConnectError("refused"), ConnectError),
        (httpx.RemoteProtocolError("gone"), ConnectError),
        (httpx.ConnectTimeout("slow"), RequestTimeoutError),
        (httpx.ReadTimeout("slow"), RequestTimeoutError),
    ],
)
async def test_no_answer_is_an_error_of_the_sdk(
    both: Both, kind: type, raised: Exception, error: type[VeilcamError]
) -> None:
    both.daemon.first = [raised] * 3
    with pytest.raises(error, match=r"http://camera\.local:1") as caught:
        await both(kind, lambda camera: camera.status())
    assert caught.value.retryable
    assert caught.value.status is None
    assert len(both.waits) == 2


@KINDS
@pytest.mark.parametrize(
    "answer",
    [
        (200, "<html>", {}),
        (200, '{"label": 7}', {}),
        (502, "Bad Gateway", {}),
        (503, "{}", {"Content-Type": "application/problem+json"}),
        (302, "", {"Location": "http://elsewhere"}),
    ],
)
async def test_what_is_no_veilcamd_is_a_protocol_error(
    both: Both, kind: type, answer: tuple[int, str, dict[str, str]]
) -> None:
    status, text, headers = answer
    both.daemon.first = [httpx.Response(status, text=text, headers=headers)]
    with pytest.raises(ProtocolError, match="is this a veilcamd"):
        await both(kind, lambda camera: camera.status())
    assert len(both.daemon.requests) == 1


@KINDS
async def test_timeouts_reach_the_transport(both: Both, kind: type) -> None:
    await both(kind, lambda camera: camera.status(), connect_timeout=1.5, read_timeout=9.0)
    timeout = both.daemon.requests[-1].extensions["timeout"]
    assert (timeout["connect"], timeout["read"]) == (1.5, 9.0)


@pytest.mark.parametrize("kind", [Camera, AsyncCamera])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"url": "ftp://camera"}, "use http://HOST:PORT or unix:///PATH"),
        ({"url": "localhost:8787"}, "use http://HOST:PORT"),
        ({"url": "unix://relative/path"}, "use http"),
        ({"connect_timeout": 0.0}, "connect_timeout = 0.0 s"),
        ({"device": "ab" * 32}, "give key= as well"),
        ({"read_timeout": float("nan")}, "read_timeout = nan s"),
    ],
)
def test_bad_arguments_are_named(kind: type, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        kind(**options)


def test_a_client_that_was_handed_in_stays_open(daemon: Daemon) -> None:
    client = httpx.Client(transport=httpx.MockTransport(daemon))
    with Camera(http_client=client) as camera:
        camera.status()
    assert not client.is_closed
    client.close()


def test_waits_are_fully_jittered_and_bounded() -> None:
    error = ConnectError("x")
    high = RetryPolicy(retries=9, uniform=lambda _, upper: upper)
    low = RetryPolicy(retries=9, uniform=lambda lower, _: lower)
    assert [high.delay(attempt, error) for attempt in range(6)] == [0.25, 0.5, 1, 2, 4, 4]
    assert low.delay(3, error) == 0
    with pytest.raises(ConnectError):
        high.delay(9, error)
    assert len({RetryPolicy().delay(0, error) for _ in range(20)}) == 20


def events(*texts: str) -> httpx.Response:
    return httpx.Response(200, text="".join(texts), headers={"Content-Type": "text/event-stream"})


def event(number: int, kind: str = "mask") -> str:
    data = {"kind": kind, "id": f"b-{number}", "at": "2026-01-02T03:04:05Z", "epoch": f"e{number}"}
    return f": heartbeat\n\nevent: {kind}\nid: b-{number}\ndata: {json.dumps(data)}\n\n"


async def collect(camera: Any, count: int) -> list[str]:
    heard = []
    stream = camera.events(last_event_id="b-0")
    if isinstance(stream, Iterator):
        for each in stream:
            heard.append(each.epoch)
            if len(heard) == count:
                break
    else:
        async for each in stream:
            heard.append(each.epoch)
            if len(heard) == count:
                break
    return heard


@KINDS
async def test_a_broken_stream_goes_on_after_the_last_event(both: Both, kind: type) -> None:
    both.daemon.first = [
        events(event(1), event(2)),
        httpx.ConnectError("restarting"),
        events(event(3), event(4, "of_the_future"), event(5)),
    ]
    assert await both(kind, lambda camera: collect(camera, 4)) == ["e1", "e2", "e3", "e5"]
    resumed = [request.headers["last-event-id"] for request in both.daemon.requests]
    assert resumed == ["b-0", "b-2", "b-2"]


@KINDS
async def test_a_stream_that_stays_away_is_an_error(both: Both, kind: type) -> None:
    both.daemon.first = [events(event(1)), *[httpx.ConnectError("gone")] * 3]
    with pytest.raises(ConnectError):
        await both(kind, lambda camera: collect(camera, 5))
    assert len(both.daemon.requests) == 3


@KINDS
async def test_a_refused_stream_is_the_error_of_its_problem(
    both: Both, kind: type, make_problem: Problem
) -> None:
    both.daemon.first = [make_problem(422, "invalid_request")]
    with pytest.raises(InvalidRequestError):
        await both(kind, lambda camera: collect(camera, 1))


@KINDS
async def test_an_unreadable_event_is_a_protocol_error(both: Both, kind: type) -> None:
    both.daemon.first = [events("event: mask\ndata: {}\n\n")]
    with pytest.raises(ProtocolError, match="update veilcam"):
        await both(kind, lambda camera: collect(camera, 1))


@pytest.mark.parametrize("size", [1, 2, 7, 1000])
def test_events_are_read_whatever_the_pieces(size: int) -> None:
    text = (
        b": comment\r\n\r\nretry: 5\nevent: a\nid: 1\ndata: x\ndata:  y\n\n"
        b"data: \xc3\xa9\xe2\x80\xa8z\r\n\r\nid: 2\n\nevent: b\n\ndata\n\nid: 3\x00\ndata: w\n\nda"
    )
    decoder = Decoder()
    found = []
    for start in range(0, len(text), size):
        found += list(decoder.feed(text[start : start + size]))
    assert found == [
        Message("a", "x\n y", "1"),
        Message("message", "\u00e9\u2028z", "1"),
        Message("message", "", "2"),
        Message("message", "w", "2"),
    ]
