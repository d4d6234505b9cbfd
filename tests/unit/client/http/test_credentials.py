"""Tokens, leases and certificates, as the SDK handles them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest
from typer.testing import CliRunner

from veilcam_client import (
    ApiError,
    AsyncCamera,
    Camera,
    ForbiddenError,
    InvalidRequestError,
    LeasedError,
    UnauthorizedError,
)
from veilcam_client.cli.main import app

if TYPE_CHECKING:
    from tests.unit.client.conftest import Daemon, Problem

TOKEN = "vc_0123456789ab_" + 64 * "5"
pytestmark = pytest.mark.anyio


def client(daemon: Daemon) -> httpx.Client:
    return httpx.Client(transport=httpx.MockTransport(daemon))


def async_client(daemon: Daemon) -> httpx.AsyncClient:
    return httpx.AsyncClient(transport=httpx.MockTransport(daemon))


async def test_every_request_carries_the_token(
    daemon: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    Camera(http_client=client(daemon)).status()
    Camera(token=TOKEN, http_client=client(daemon)).classify()
    await AsyncCamera(token=TOKEN, http_client=async_client(daemon)).classify()
    monkeypatch.setenv("VEILCAM_TOKEN", "vc_from_the_environment")
    Camera(http_client=client(daemon)).status()
    Camera(token=TOKEN, http_client=client(daemon)).status()
    assert [request.headers.get("authorization") for request in daemon.requests] == [
        None,
        f"Bearer {TOKEN}",
        f"Bearer {TOKEN}",
        "Bearer vc_from_the_environment",
        f"Bearer {TOKEN}",
    ]


@pytest.mark.parametrize("url", ["http://camera.local:8787", "http://10.0.0.7:8787"])
def test_token_is_not_sent_in_the_clear(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="in the clear: use https") as caught:
        Camera(url, token=TOKEN)
    assert TOKEN not in str(caught.value)
    Camera(url).close()
    monkeypatch.setenv("VEILCAM_TOKEN", TOKEN)
    with pytest.raises(ValueError, match="in the clear"):
        Camera(url)


@pytest.mark.parametrize(
    "url",
    [
        "https://camera.local:8787",
        "http://127.0.0.1:8787",
        "http://127.3.2.1",
        "http://[::1]:1",
        "http://localhost:1",
        "unix:///run/veilcam/api.sock",
    ],
)
def test_token_is_sent_where_nobody_listens(url: str) -> None:
    camera = Camera(url, token=TOKEN)
    assert TOKEN not in repr(vars(camera)) + repr(camera._transport.options)
    camera.close()


@pytest.mark.parametrize("token", ["vc 1", "vc_1\n", "vc_é"])
def test_invalid_token_is_refused_and_not_repeated(token: str) -> None:
    with pytest.raises(ValueError, match="the token is not valid") as caught:
        Camera(token=token)
    assert token not in str(caught.value)


def test_authority_that_cannot_be_read_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nothing, empty = tmp_path / "nothing.pem", tmp_path / "empty.pem"
    empty.touch()
    for path in (nothing, empty):
        with pytest.raises(ValueError, match=rf"{path.name}' cannot be used"):
            Camera("https://camera.local", ca_file=path)
        monkeypatch.setenv("VEILCAM_CA_FILE", str(path))
        with pytest.raises(ValueError, match=rf"{path.name}' cannot be used"):
            Camera("https://camera.local")
        monkeypatch.delenv("VEILCAM_CA_FILE")


@pytest.mark.parametrize(
    "wanted",
    [
        (401, "unauthorized", UnauthorizedError, 10),
        (403, "forbidden", ForbiddenError, 11),
        (403, "embedding_withheld", InvalidRequestError, 5),
        (423, "leased", LeasedError, 12),
    ],
)
async def test_errors_by_code(
    daemon: Daemon,
    make_problem: Problem,
    wanted: tuple[int, str, type[ApiError], int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    status, code, kind, exit_code = wanted
    daemon.first = [make_problem(status, code), make_problem(status, code)]
    with pytest.raises(kind) as caught:
        Camera(http_client=client(daemon)).classify()
    assert type(caught.value) is kind
    # A stream with a dead token ends instead of asking for ever.
    with pytest.raises(kind):
        next(iter(Camera(http_client=client(daemon)).events()))
    assert len(daemon.requests) == 2

    def ask(*_: Any) -> None:
        raise caught.value

    monkeypatch.setattr(Camera, "classify", ask)
    assert CliRunner().invoke(app, ["classify"]).exit_code == exit_code


async def test_lease_lasts_as_long_as_its_context(daemon: Daemon) -> None:
    with Camera(http_client=client(daemon)) as camera:
        with camera.lease(seconds=10, owner="me") as lease:
            assert lease.held
            assert camera.lease_state().mine
            camera.classify()
            camera.take_lease(seconds=10, owner="me")
        camera.classify()
    async with (
        AsyncCamera(http_client=async_client(daemon)) as other,
        other.lease(seconds=10, owner="me"),
    ):
        await other.classify()
    sent = [
        (
            request.method,
            request.url.path.removeprefix("/v1/"),
            request.headers.get("veilcam-lease"),
        )
        for request in daemon.requests
    ]
    assert sent == [
        ("POST", "lease", None),
        ("GET", "lease", "5ec2e7"),
        ("POST", "classifications", "5ec2e7"),
        ("POST", "lease", "5ec2e7"),
        ("DELETE", "lease", "5ec2e7"),
        ("POST", "classifications", None),
        ("POST", "lease", None),
        ("POST", "classifications", "5ec2e7"),
        ("DELETE", "lease", "5ec2e7"),
    ]
    assert b'"owner":"me"' in daemon.requests[0].content


async def test_lease_of_another_is_ended_by_force(daemon: Daemon) -> None:
    with Camera(http_client=client(daemon)) as camera:
        assert not camera.break_lease().held
        camera.release_lease()
    async with AsyncCamera(http_client=async_client(daemon)) as other:
        assert not (await other.break_lease()).held
    assert [request.url.raw_path for request in daemon.requests] == [
        b"/v1/lease?force=true",
        b"/v1/lease",
        b"/v1/lease?force=true",
    ]


@pytest.mark.parametrize(
    ("options", "method", "said"),
    [
        ([], "GET", "held by 'me' for another 10 s"),
        (["--break"], "DELETE", "nobody holds the camera"),
    ],
)
@pytest.mark.usefixtures("url")
def test_lease_from_a_terminal(daemon: Daemon, options: list[str], method: str, said: str) -> None:
    result = CliRunner().invoke(app, ["lease", *options])
    assert (result.exit_code, result.stdout.strip()) == (0, said)
    assert daemon.requests[0].method == method
    assert '"held":' in CliRunner().invoke(app, ["lease", *options, "--json"]).stdout


def test_lease_is_given_back_when_something_fails(daemon: Daemon) -> None:
    camera = Camera(http_client=client(daemon))
    with pytest.raises(RuntimeError), camera.lease(seconds=10):
        raise RuntimeError
    assert daemon.requests[-1].method == "DELETE"


@pytest.mark.parametrize("seconds", [0, 3601])
def test_lease_that_cannot_be_is_refused_before_it_is_asked_for(
    daemon: Daemon, seconds: float
) -> None:
    with pytest.raises(ValueError, match="seconds"):
        Camera(http_client=client(daemon)).take_lease(seconds=seconds)
    assert not daemon.requests


def ways() -> list[Callable[[Any], Any]]:
    return [
        lambda camera: camera.tokens(),
        lambda camera: camera.tokens(limit=5, after="0123456789ab"),
        lambda camera: camera.create_token("a lamp", ["classify"], seconds=60),
        lambda camera: camera.revoke_token("0123456789ab"),
        lambda camera: camera.diagnostics(),
    ]


async def test_tokens_and_diagnostics_by_both_cameras(daemon: Daemon) -> None:
    for ask in ways():
        answer = ask(Camera(http_client=client(daemon)))
        assert await ask(AsyncCamera(http_client=async_client(daemon))) == answer
    made = Camera(http_client=client(daemon)).create_token("a lamp", ["classify"])
    assert made.secret == TOKEN
    assert TOKEN not in repr(made)


def test_tokens_are_asked_for_a_page_at_a_time(daemon: Daemon) -> None:
    camera = Camera(http_client=client(daemon))
    camera.tokens()
    camera.tokens(limit=5, after="a&b")
    asked = [request.url.query for request in daemon.requests]
    assert asked == [b"limit=100", b"limit=5&after=a%26b"]


def test_id_stays_one_part_of_the_path(daemon: Daemon) -> None:
    with pytest.raises(KeyError, match="tokens/"):
        Camera(http_client=client(daemon)).revoke_token("../status?x")
    assert daemon.requests[0].url.raw_path == b"/v1/tokens/..%2Fstatus%3Fx"
