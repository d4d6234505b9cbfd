"""Cameras over a mock transport: requests, retries, errors, streams."""

from __future__ import annotations

import json
import logging
import math
import re
from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest
from tests.unit.client.conftest import CLASSIFICATION, STATUS, Daemon, camera_of, problem, result
from tests.unit.client.http.conftest import Both
from typer.testing import CliRunner

from veilcam_client import Camera, VeilcamError
from veilcam_client.cli.main import app
from veilcam_client.errors import (
    AccessError,
    ApiError,
    BusyError,
    ConnectError,
    DeviceError,
    LeasedError,
    ProtocolError,
    RequestTimeoutError,
)
from veilcam_client.http.options import RetryPolicy
from veilcam_client.models import EverySeconds, RotationOff, Watching
from veilcam_client.wire.base import CALL_HEADER, RUN_HEADER, UNKNOWN_RUN, Nothing

pytestmark = pytest.mark.anyio


Ask = Callable[[Any], Any]
AB = "ab" * 32
LAMP: dict[str, Any] = {"label": "a lamp", "role": None, "scopes": [], "seconds": None}
ROUTES: list[tuple[Ask, str, Any]] = [
    (lambda camera: camera.status(), "GET status", None),
    (lambda camera: camera.diagnostics(), "GET diagnostics", None),
    (lambda camera: camera.capture(), "POST captures", None),
    (lambda camera: camera.classify(), "POST classifications", None),
    (
        lambda camera: camera.classify(include_embedding=True),
        *("POST classifications", {"include_embedding": True}),
    ),
    (lambda camera: camera.rotation.get(), "GET rotation", None),
    (
        lambda camera: camera.rotation.set(EverySeconds(seconds=7)),
        *("PUT rotation", {"mode": "seconds", "seconds": 7.0, "jitter": 0.0, "reuse": 0}),
    ),
    (lambda camera: camera.rotation.set(RotationOff()), "PUT rotation", {"mode": "off"}),
    (lambda camera: camera.rotation.advance(), "POST rotation/advance", None),
    (lambda camera: camera.watch.get(), "GET watch", None),
    (
        lambda camera: camera.watch.set(Watching(rate_hz=2.0)),
        *("PUT watch", {"mode": "watching", "rate_hz": 2.0, "quiet": None}),
    ),
    (lambda camera: camera.receivers.list(), "GET receivers", None),
    (
        lambda camera: camera.receivers.add("archive", "veilcam-receiver:c2VhbGVk"),
        *("POST receivers", {"label": "archive", "key": "veilcam-receiver:c2VhbGVk"}),
    ),
    (lambda camera: camera.receivers.remove(AB), f"DELETE receivers/{AB}", None),
    (lambda camera: camera.receivers.offer(), "POST pairing", {"role": "operator"}),
    (
        lambda camera: camera.receivers.claim("0f" * 16, "a", "veilcam-receiver:c2VhbGVk"),
        "POST pairing/claim",
        {"label": "a", "key": "veilcam-receiver:c2VhbGVk", "secret": "0f" * 16},
    ),
    (lambda camera: camera.bundles.list(), "GET bundles", None),
    (lambda camera: camera.bundles.install(b"[7]"), "POST bundles", [7]),
    (lambda camera: camera.bundles.activate(AB), f"POST bundles/{AB}/activate", None),
    (lambda camera: camera.bundles.remove(AB), f"DELETE bundles/{AB}", None),
    (lambda camera: camera.calibration.get(), "GET calibration", None),
    (lambda camera: camera.calibration.start(repeats=3), "POST calibration", {"repeats": 3}),
    (
        lambda camera: camera.calibration.confirm("lamp"),
        "POST calibration/scene",
        {"scene": "lamp"},
    ),
    (lambda camera: camera.calibration.cancel(), "DELETE calibration", None),
    (lambda camera: camera.log.list(), "GET log?limit=1000", None),
    (lambda camera: camera.log.list(limit=5, after=0), "GET log?limit=5&after=0", None),
    (lambda camera: camera.tokens.list(), "GET tokens?limit=100", None),
    (
        lambda camera: camera.tokens.list(limit=5, after="a&b"),
        "GET tokens?limit=5&after=a%26b",
        None,
    ),
    (
        lambda camera: camera.tokens.create("a lamp", ["classify"], seconds=60),
        *("POST tokens", {**LAMP, "scopes": ["classify"], "seconds": 60}),
    ),
    (
        lambda camera: camera.tokens.create("a lamp", role="owner"),
        *("POST tokens", {**LAMP, "role": "owner"}),
    ),
    (lambda camera: camera.tokens.revoke("0123456789ab"), "DELETE tokens/0123456789ab", None),
    (lambda camera: camera.lease.revoke(), "DELETE lease?force=true", None),
    (lambda camera: camera.lease.release(), "DELETE lease", None),
]


async def test_every_method_asks_its_route(both: Both) -> None:
    for ask, route, body in ROUTES:
        answer = await both(ask)
        assert answer == await both(ask, kind=Camera)
        request = both.daemon.requests[-2]
        method, path = route.split()
        assert (request.method, request.url.raw_path.decode()) == (method, f"/v1/{path}")
        assert (json.loads(request.content) if request.content else None) == body
        # A bundle that is installed twice is installed, and a line is used once anyway.
        once = method == "POST" and path not in ("bundles", "pairing/claim")
        assert ("idempotency-key" in request.headers) is once


async def test_name_stays_one_part_of_the_path(both: Both) -> None:
    asks: dict[str, Ask] = {
        "/v1/bundles/..%2Fstatus%3Fx/activate": lambda camera: camera.bundles.activate(
            "../status?x"
        ),
        "/v1/tokens/..%2Fstatus%3Fx": lambda camera: camera.tokens.revoke("../status?x"),
    }
    for path, ask in asks.items():
        with pytest.raises(KeyError):
            await both(ask)
        assert both.daemon.requests[-1].url.raw_path.decode() == path


async def test_results_are_typed(both: Both) -> None:
    assert np.asarray(await both(lambda camera: camera.capture())).shape == (2, 3)
    active, other = (await both(lambda camera: camera.bundles.list())).bundles
    assert (active.active, active.bundle, other.bundle.task) == (True, None, "fashion")
    assert await both(lambda camera: camera.receivers.remove(AB)) == Nothing()
    await both(lambda camera: camera.bundles.install(b"bundle"))
    sent = both.daemon.requests[-1].headers["content-type"]
    assert sent == "application/vnd.veilcam.bundle"


@pytest.mark.parametrize(
    "case",
    [
        (401, "unauthorized", AccessError, 4),
        (403, "forbidden", AccessError, 4),
        (403, "embedding_withheld", ApiError, 4),
        (409, "rotation_impossible", ApiError, 4),
        (422, "invalid_request", ApiError, 4),
        (423, "leased", LeasedError, 5),
        (429, "queue_full", BusyError, 5),
        (503, "sensor_failed", DeviceError, 6),
        (500, "internal_error", ApiError, 4),
    ],
)
async def test_problem_is_the_error_of_its_status(
    both: Both, case: tuple[int, str, type[ApiError], int], monkeypatch: pytest.MonkeyPatch
) -> None:
    status, code, error, exit_code = case
    both.daemon.first = [problem(status, code)]
    with pytest.raises(VeilcamError) as caught:
        await both(lambda camera: camera.capture())
    found = caught.value
    assert type(found) is error
    assert isinstance(found, ApiError)
    assert (found.code, found.status, found.request_id) == (code, status, "r1")
    assert not found.retryable
    assert found.errors[0].location == "body.seconds"
    assert str(found).startswith(f"what went wrong: {code}")
    assert len(both.daemon.requests) == 1

    def ask(*_: Any, **__: Any) -> None:
        raise found

    monkeypatch.setattr(Camera, "classify", ask)
    told = CliRunner().invoke(app, ["classify"])
    assert told.exit_code == exit_code
    assert told.stderr == f"veilcam: error: {found} [{code}, request r1]\n"


async def test_retryable_call_is_repeated_with_the_same_key(both: Both) -> None:
    both.daemon.first = [
        problem(503, "sensor_failed", retryable=True, **{"Retry-After": "3"}),
        httpx.ReadTimeout("slow"),
    ]
    assert (await both(lambda camera: camera.capture())).id == "c1"
    keys = {request.headers["idempotency-key"] for request in both.daemon.requests}
    assert len(both.daemon.requests) == 3
    assert len(keys) == 1
    assert 3 <= both.waits[0] <= 3.25
    assert 0 <= both.waits[1] <= 0.5
    await both(lambda camera: camera.capture())
    assert both.daemon.requests[-1].headers["idempotency-key"] not in keys


class Restarting(Daemon):
    """Daemon that names its run, and refuses the keys of another one.

    An error among ``first`` is the end of a run: the next request meets the next run.
    """

    def __init__(self) -> None:
        super().__init__()
        self.run = 1

    def __call__(self, request: httpx.Request) -> httpx.Response:
        if request.headers.get(RUN_HEADER) not in (None, str(self.run)):
            self.first.insert(0, problem(409, "answer_lost"))
        try:
            answer = super().__call__(request)
        except httpx.RequestError:
            self.run += 1
            raise
        answer.headers[RUN_HEADER] = str(self.run)
        return answer

    @property
    def runs(self) -> list[str | None]:
        return [request.headers.get(RUN_HEADER) for request in self.requests]


@pytest.fixture
def restarting() -> Restarting:
    return Restarting()


@pytest.fixture
def camera(restarting: Restarting, both: Both) -> Any:
    return camera_of(both.kind, restarting, url="http://camera.local:1")


async def test_run_that_answered_last_goes_with_each_key(
    camera: Any, restarting: Restarting
) -> None:
    for ask in (camera.capture, camera.status, camera.capture, camera.rotation.get):
        await result(ask())
    assert restarting.runs == [None, None, "1", None]


async def test_call_after_a_restart_is_asked_again_with_the_new_run(
    camera: Any, restarting: Restarting
) -> None:
    await result(camera.status())
    restarting.run = 2
    assert (await result(camera.capture())).id == "c1"
    assert restarting.runs == [None, "1", "2"]
    restarting.first = [problem(409, "answer_lost") for _ in "12"]
    with pytest.raises(ApiError):
        await result(camera.capture())
    assert restarting.runs[3:] == ["2", "2"]


@pytest.mark.parametrize("error", [httpx.ReadError, httpx.ReadTimeout, httpx.RemoteProtocolError])
@pytest.mark.parametrize("seen", [True, False])
async def test_call_that_may_be_done_is_not_done_again_after_a_restart(
    camera: Any, restarting: Restarting, error: type[httpx.RequestError], seen: bool
) -> None:
    if seen:
        await result(camera.status())
    restarting.requests.clear()
    restarting.first = [error("broken")]
    with pytest.raises(ApiError) as caught:
        await result(camera.capture())
    assert caught.value.code == "answer_lost"
    assert restarting.runs == (["1", "1"] if seen else [None, UNKNOWN_RUN])


async def test_call_that_was_not_done_is_asked_of_the_next_run(
    camera: Any, restarting: Restarting
) -> None:
    await result(camera.status())
    restarting.first = [httpx.ConnectError("refused")]
    assert (await result(camera.capture())).id == "c1"
    assert restarting.runs == [None, "1", "1", "2"]
    restarting.first = [problem(503, "not_ready", retryable=True), httpx.ConnectTimeout("slow")]
    assert (await result(camera.capture())).id == "c1"
    assert restarting.runs[4:] == ["2", "2", "2", "3"]


async def test_run_that_is_no_text_is_not_sent(both: Both) -> None:
    camera = camera_of(both.kind, both.daemon, url="http://camera.local:1")
    both.daemon.first = [httpx.Response(200, json=STATUS, headers=[(b"Veilcam-Run", b"\xe4")])]
    await result(camera.status())
    await result(camera.capture())
    assert RUN_HEADER not in both.daemon.requests[-1].headers


async def test_call_is_named_anew_for_every_attempt(both: Both) -> None:
    both.daemon.first = [problem(503, "sensor_failed", retryable=True)]
    await both(lambda camera: camera.capture())
    await both(lambda camera: camera.status())
    named = [request.headers[CALL_HEADER] for request in both.daemon.requests]
    assert all(re.fullmatch("[0-9a-f]{32}", each) for each in named)
    assert len(set(named)) == 3


@pytest.mark.parametrize("status", [200, 401, 503])
async def test_answer_to_another_call_is_a_protocol_error(both: Both, status: int) -> None:
    for named in ("0" * 32, "", "0" * 31):
        foreign = problem(status, "unauthorized", retryable=True)
        foreign.headers[CALL_HEADER] = named
        both.daemon.first = [foreign]
        both.daemon.requests.clear()
        with pytest.raises(ProtocolError, match="answer to another request"):
            await both(lambda camera: camera.status())
        assert len(both.daemon.requests) == 1


async def test_retries_end_where_they_were_told_to(both: Both) -> None:
    busy = problem(429, "queue_full", retryable=True)
    for retries in (0, 2, 4):
        both.daemon.first = [busy] * 5
        both.daemon.requests.clear()
        with pytest.raises(BusyError):
            await both(lambda camera: camera.capture(), max_retries=retries)
        assert len(both.daemon.requests) == 1 + retries


async def test_wait_beyond_all_patience_is_not_waited(both: Both) -> None:
    both.daemon.first = [problem(503, "x", retryable=True, **{"Retry-After": "3600"})]
    with pytest.raises(DeviceError) as caught:
        await both(lambda camera: camera.capture())
    assert caught.value.retry_after == 3600
    assert both.waits == []


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
    both: Both, raised: Exception, error: type[VeilcamError]
) -> None:
    both.daemon.first = [raised] * 3
    with pytest.raises(error, match=r"http://camera\.local:1") as caught:
        await both(lambda camera: camera.status())
    assert caught.value.retryable
    assert caught.value.status is None
    assert len(both.waits) == 2


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
    both: Both, answer: tuple[int, str, dict[str, str]]
) -> None:
    status, text, headers = answer
    both.daemon.first = [httpx.Response(status, text=text, headers=headers)]
    with pytest.raises(ProtocolError, match="is this a veilcamd"):
        await both(lambda camera: camera.status())
    assert len(both.daemon.requests) == 1


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


async def test_deadline_ends_repetitions_too(both: Both) -> None:
    both.daemon.first = [httpx.ConnectError("refused")] * 9
    with pytest.raises(ConnectError):
        await both(lambda camera: camera.status(timeout=1e-9), max_retries=9)
    assert len(both.daemon.requests) == 1
    assert both.waits == []
    both.daemon.requests.clear()
    with pytest.raises(ConnectError):
        await both(lambda camera: camera.status(timeout=None), max_retries=3, timeout=1e-9)
    assert len(both.daemon.requests) == 4


async def test_deadline_bounds_what_a_socket_may_wait(both: Both) -> None:
    for timeout, longest in ((None, 9.0), (60.0, 9.0), (4.0, 4.0), (0.5, 0.5)):
        waits = {"connect_timeout": 1.5, "read_timeout": 9.0, "timeout": timeout}
        await both(lambda camera: camera.status(), **waits)
        asked = both.daemon.requests[-1].extensions["timeout"]
        assert min(1.5, longest) - 0.4 < asked["connect"] <= min(1.5, longest)
        assert longest - 0.4 < asked["read"] <= longest


async def test_lease_of_another_is_told_at_once_unless_waited_for(both: Both) -> None:
    held = problem(423, "leased", retryable=True, **{"Retry-After": "20"})
    both.daemon.first = [held]
    with pytest.raises(LeasedError) as caught:
        await both(lambda camera: camera.capture())
    assert caught.value.retry_after == 20
    assert (both.waits, len(both.daemon.requests)) == ([], 1)
    both.daemon.first = [held] * 5
    both.daemon.requests.clear()
    ask = lambda camera: camera.capture(wait=math.inf, timeout=0.5)  # noqa: E731
    assert (await both(ask, max_retries=0)).id == "c1"
    assert len(both.daemon.requests) == 6
    assert all(0.5 <= pause <= 1 for pause in both.waits)
    assert len({request.headers["idempotency-key"] for request in both.daemon.requests}) == 1


async def test_patience_with_another_holder_ends(both: Both) -> None:
    both.daemon.first = [problem(423, "leased", retryable=True, **{"Retry-After": "20"})] * 9
    for ask in (
        lambda camera: camera.classify(wait=0),
        lambda camera: camera.rotation.advance(wait=1e-9),
    ):
        with pytest.raises(LeasedError):
            await both(ask)
    assert sum(both.waits) <= 1e-9


async def test_every_result_names_its_request(both: Both) -> None:
    def answer(request: httpx.Request) -> httpx.Response:
        found = both.daemon(request)
        found.headers["X-Request-Id"] = "r9"
        return found

    for ask, route, _ in ROUTES:
        camera = camera_of(both.kind, answer)
        found = await result(ask(camera))
        assert found.request_id == "r9", route
        unnamed = await both(ask)
        assert (unnamed.request_id, dict(unnamed), unnamed) == (None, dict(found), found)


async def test_raw_answer_names_its_request(both: Both) -> None:
    both.daemon.first = [
        httpx.ConnectError("refused"),
        httpx.Response(200, json=CLASSIFICATION, headers={"X-Request-Id": "r7"}),
    ]
    raw = await both(lambda camera: camera.raw(camera.classify, timeout=9))
    assert (raw.status_code, raw.request_id) == (200, "r7")
    assert raw.headers["x-REQUEST-id"] == "r7"
    assert json.loads(raw.content) == CLASSIFICATION
    assert (raw.parse().label, raw.parse().confidence) == ("7", 0.9)
    bundles = await both(lambda camera: camera.raw(camera.bundles.list))
    assert (len(bundles.parse().bundles), bundles.request_id) == (2, None)


async def test_base_with_its_version_is_understood(both: Both) -> None:
    for base in ("http://camera.local/v1", "http://camera.local/v1/", "http://camera.local/"):
        await both(lambda camera: camera.status(), url=base)
    both.daemon.first = [httpx.Response(200, json=STATUS)]
    await both(lambda camera: camera.status(), url="http://camera.local/cellar/v1")
    assert [request.url.path for request in both.daemon.requests] == [
        *["/v1/status"] * 3,
        "/cellar/v1/status",
    ]


async def test_repetitions_are_logged_and_secrets_are_not(
    both: Both, caplog: pytest.LogCaptureFixture
) -> None:
    token = "vc_0123456789ab_" + 64 * "5"
    both.daemon.first = [httpx.ConnectError("refused")]
    with caplog.at_level("INFO", "veilcam"):
        await both(lambda camera: camera.status(), token=token, url="http://localhost")
    assert "once more in" in caplog.text
    assert "connection_failed" in caplog.text
    assert "GET /v1/status" not in caplog.text
    with caplog.at_level("DEBUG", "veilcam"):
        await both(lambda camera: camera.tokens.list(), token=token, url="http://localhost")
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
