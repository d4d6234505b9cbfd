"""Tokens, leases and certificates, as the SDK handles them."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.unit.client.conftest import Daemon, camera_of
from typer.testing import CliRunner

from veilcam_client import AsyncCamera, Camera
from veilcam_client.cli.main import app

TOKEN = "vc_0123456789ab_" + 64 * "5"
pytestmark = pytest.mark.anyio


async def test_every_request_carries_the_token(
    daemon: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera_of(Camera, daemon).status()
    camera_of(Camera, daemon, token=TOKEN).classify()
    await camera_of(AsyncCamera, daemon, token=TOKEN).classify()
    monkeypatch.setenv("VEILCAM_TOKEN", "vc_from_the_environment")
    camera_of(Camera, daemon).status()
    camera_of(Camera, daemon, token=TOKEN).status()
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
        *("https://camera.local:8787", "http://127.0.0.1:8787", "http://127.3.2.1"),
        *("http://[::1]:1", "http://localhost:1", "unix:///run/veilcam/api.sock"),
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


async def test_lease_lasts_as_long_as_its_context(daemon: Daemon) -> None:
    with camera_of(Camera, daemon) as camera:
        with camera.lease.hold(seconds=10, owner="me") as lease:
            assert lease.held
            assert camera.lease.get().mine
            camera.classify()
            camera.lease.take(seconds=10, owner="me")
        camera.classify()
    other = camera_of(AsyncCamera, daemon)
    async with other, other.lease.hold(seconds=10, owner="me"):
        await other.classify()
    sent = [
        f"{request.method} {request.url.path[4:]} {request.headers.get('veilcam-lease')}"
        for request in daemon.requests
    ]
    assert sent == [
        *("POST lease None", "GET lease 5ec2e7", "POST classifications 5ec2e7"),
        *("POST lease 5ec2e7", "DELETE lease 5ec2e7", "POST classifications None"),
        *("POST lease None", "POST classifications 5ec2e7", "DELETE lease 5ec2e7"),
    ]
    assert b'"owner":"me"' in daemon.requests[0].content


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
    camera = camera_of(Camera, daemon)
    with pytest.raises(RuntimeError), camera.lease.hold(seconds=10):
        raise RuntimeError
    assert daemon.requests[-1].method == "DELETE"


def test_secret_of_a_token_is_not_shown(daemon: Daemon) -> None:
    made = camera_of(Camera, daemon).tokens.create("a lamp", ["classify"])
    assert made.secret == TOKEN
    assert TOKEN not in repr(made)
