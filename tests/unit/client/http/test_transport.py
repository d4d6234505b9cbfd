"""Cameras over a mock transport: requests, retries, errors, streams."""

from __future__ import annotations

import json
import logging
import math
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import httpx
import numpy as np
import pytest
from tests.unit.client.conftest import CLASSIFICATION, STATUS

from veilcam_client import (
    ApiError,
    AsyncCamera,
    BusyError,
    Camera,
    ConnectError,
    DeviceError,
    EverySeconds,
    InvalidRequestError,
    LeasedError,
    ProtocolError,
    RequestTimeoutError,
    RotationOff,
    ServerError,
    VeilcamError,
    Watching,
)
from veilcam_client.http.options import RetryPolicy
from veilcam_client.wire.base import CALL_HEADER

if TYPE_CHECKING:
    from tests.unit.client.conftest import Daemon, Problem
    from tests.unit.client.http.conftest import Both

pytestmark = pytest.mark.anyio


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
        (lambda camera: camera.watch(), "GET", "/v1/watch", None),
        (
            lambda camera: camera.set_watch(Watching(rate_hz=2.0)),
            "PUT",
            "/v1/watch",
            {"mode": "watching", "rate_hz": 2.0, "quiet": None},
        ),
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
async def test_problem_is_the_error_of_its_status(
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
async def test_retryable_call_is_repeated_with_the_same_key(
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
async def test_call_is_named_anew_for_every_attempt(
    both: Both, kind: type, make_problem: Problem
) -> None:
    both.daemon.first = [make_problem(503, "sensor_failed", retryable=True)]
    await both(kind, lambda camera: camera.capture())
    await both(kind, lambda camera: camera.status())
    named = [request.headers[CALL_HEADER] for request in both.daemon.requests]
    assert all(re.fullmatch("[0-9a-f]{32}", each) for each in named)
    assert len(set(named)) == 3


@KINDS
@pytest.mark.parametrize("status", [200, 401, 503])
async def test_answer_to_another_call_is_a_protocol_error(
    both: Both, kind: type, status: int, make_problem: Problem
) -> None:
    for named in ("0" * 32, "", "0" * 31):
        foreign = make_problem(status, "unauthorized", retryable=True)
        foreign.headers[CALL_HEADER] = named
        both.daemon.first = [foreign]
        both.daemon.requests.clear()
        with pytest.raises(ProtocolError, match="answer to another request"):
            await both(kind, lambda camera: camera.status())
        assert len(both.daemon.requests) == 1


@KINDS
async def test_retries_end_where_they_were_told_to(
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
async def test_wait_beyond_all_patience_is_not_waited(
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
async def test_missing_answer_is_an_error_of_the_sdk(
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
async def test_foreign_server_is_a_protocol_error(
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
        ({"url": "http://camera?token=1"}, "use http"),
        ({"connect_timeout": 0.0}, "connect_timeout = 0.0 s"),
        ({"timeout": 0.0}, r"timeout = 0.0 s is not valid: use > 0, or None"),
        ({"device": "ab" * 32}, "give key= as well"),
        ({"read_timeout": float("nan")}, "read_timeout = nan s"),
    ],
)
def test_bad_arguments_are_named(kind: type, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        kind(**options)


def test_client_that_was_handed_in_stays_open(daemon: Daemon) -> None:
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


@KINDS
async def test_deadline_ends_repetitions_too(both: Both, kind: type) -> None:
    both.daemon.first = [httpx.ConnectError("refused")] * 9
    with pytest.raises(ConnectError):
        await both(kind, lambda camera: camera.status(timeout=1e-9), max_retries=9)
    assert len(both.daemon.requests) == 1
    assert both.waits == []
    both.daemon.requests.clear()
    with pytest.raises(ConnectError):
        await both(kind, lambda camera: camera.status(timeout=None), max_retries=3, timeout=1e-9)
    assert len(both.daemon.requests) == 4


@KINDS
async def test_deadline_bounds_what_a_socket_may_wait(both: Both, kind: type) -> None:
    for timeout, longest in ((None, 9.0), (60.0, 9.0), (4.0, 4.0), (0.5, 0.5)):
        await both(kind, lambda camera: camera.status(), read_timeout=9.0, timeout=timeout)
        asked = both.daemon.requests[-1].extensions["timeout"]
        assert min(2.0, longest) - 0.4 < asked["connect"] <= min(2.0, longest)
        assert longest - 0.4 < asked["read"] <= longest


@KINDS
async def test_lease_of_another_is_told_at_once_unless_waited_for(
    both: Both, kind: type, make_problem: Problem
) -> None:
    held = make_problem(423, "leased", retryable=True, **{"Retry-After": "20"})
    both.daemon.first = [held]
    with pytest.raises(LeasedError) as caught:
        await both(kind, lambda camera: camera.capture())
    assert caught.value.retry_after == 20
    assert (both.waits, len(both.daemon.requests)) == ([], 1)
    both.daemon.first = [held] * 5
    both.daemon.requests.clear()
    capture = await both(
        kind, lambda camera: camera.capture(wait=math.inf, timeout=0.5), max_retries=0
    )
    assert capture.id == "c1"
    assert len(both.daemon.requests) == 6
    assert all(0.5 <= pause <= 1 for pause in both.waits)
    assert len({request.headers["idempotency-key"] for request in both.daemon.requests}) == 1


@KINDS
async def test_patience_with_another_holder_ends(
    both: Both, kind: type, make_problem: Problem
) -> None:
    both.daemon.first = [make_problem(423, "leased", retryable=True, **{"Retry-After": "20"})] * 9
    for ask in (lambda camera: camera.classify(wait=0), lambda camera: camera.rotate(wait=1e-9)):
        with pytest.raises(LeasedError):
            await both(kind, ask)
    assert sum(both.waits) <= 1e-9
    with pytest.raises(ValueError, match=r"wait = -1 s is not valid"):
        await both(kind, lambda camera: camera.rotate(wait=-1))


@KINDS
async def test_raw_answer_names_its_request(both: Both, kind: type) -> None:
    both.daemon.first = [
        httpx.ConnectError("refused"),
        httpx.Response(200, json=CLASSIFICATION, headers={"X-Request-Id": "r7"}),
    ]
    raw = await both(kind, lambda camera: camera.with_raw_response.classify(timeout=9))
    assert (raw.status_code, raw.request_id) == (200, "r7")
    assert raw.headers["x-REQUEST-id"] == "r7"
    assert json.loads(raw.content) == CLASSIFICATION
    assert (raw.parse().label, raw.parse().confidence) == ("7", 0.9)
    bundles = await both(kind, lambda camera: camera.with_raw_response.bundles())
    assert (len(bundles.parse()), bundles.request_id) == (2, None)


@KINDS
async def test_base_with_its_version_is_understood(both: Both, kind: type) -> None:
    for base in ("http://camera.local/v1", "http://camera.local/v1/", "http://camera.local/"):
        await both(kind, lambda camera: camera.status(), url=base)
    both.daemon.first = [httpx.Response(200, json=STATUS)]
    await both(kind, lambda camera: camera.status(), url="http://camera.local/cellar/v1")
    assert [request.url.path for request in both.daemon.requests] == [
        *["/v1/status"] * 3,
        "/cellar/v1/status",
    ]


@KINDS
async def test_address_stands_in_the_environment(
    both: Both, kind: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VEILCAM_URL", "http://elsewhere:7")
    await both(kind, lambda camera: camera.status(), url=None)
    await both(kind, lambda camera: camera.status(), url="http://here:8")
    monkeypatch.setenv("VEILCAM_URL", "")
    await both(kind, lambda camera: camera.status(), url=None)
    assert [request.url.host for request in both.daemon.requests] == [
        *("elsewhere", "here", "127.0.0.1")
    ]


@KINDS
async def test_repetitions_are_logged_and_secrets_are_not(
    both: Both, kind: type, caplog: pytest.LogCaptureFixture
) -> None:
    token = "vc_0123456789ab_" + 64 * "5"
    both.daemon.first = [httpx.ConnectError("refused")]
    with caplog.at_level("INFO", "veilcam"):
        await both(kind, lambda camera: camera.status(), token=token, url="http://localhost")
    assert "once more in" in caplog.text
    assert "connection_failed" in caplog.text
    assert "GET /v1/status" not in caplog.text
    with caplog.at_level("DEBUG", "veilcam"):
        await both(kind, lambda camera: camera.tokens(), token=token, url="http://localhost")
    assert "GET /v1/tokens: 200" in caplog.text
    assert "limit=" not in caplog.text
    assert token not in caplog.text


@pytest.mark.parametrize("asked", ["debug", "info", ""])
def test_environment_says_what_is_logged(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], asked: str
) -> None:
    fresh = logging.Logger("veilcam")
    monkeypatch.setattr("veilcam_client.http.options.log", fresh)
    monkeypatch.setenv("VEILCAM_LOG", asked)
    for _ in range(2):
        Camera("http://localhost").close()
    fresh.info("told")
    fresh.debug("whispered")
    shown = capsys.readouterr().err
    assert shown.count("told") == (asked != "")
    assert shown.count("whispered") == (asked == "debug")
    monkeypatch.setenv("VEILCAM_LOG", "loud")
    with pytest.raises(ValueError, match="VEILCAM_LOG = 'loud' is not valid: use debug or info"):
        Camera("http://localhost")
