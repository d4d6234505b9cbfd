"""Passwords in addresses: they reach whoever is asked, and no message, log or ``repr``."""

from __future__ import annotations

import base64
import logging

import httpx
import pytest
from tests.unit.client.conftest import Daemon, camera_of, result
from typer.testing import CliRunner

from veilcam_client import Camera, VeilcamError
from veilcam_client.arguments import masked
from veilcam_client.cli.main import app

pytestmark = pytest.mark.anyio
PASSWORD = "hunter2"


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("http://127.0.0.1:8787", "http://127.0.0.1:8787"),
        ("https://camera.local/cellar", "https://camera.local/cellar"),
        ("unix:///run/veilcam@1/api.sock", "unix:///run/veilcam@1/api.sock"),
        (f"http://user:{PASSWORD}@camera.local:1", "http://***@camera.local:1"),
        (f"http://{PASSWORD}@camera.local", "http://***@camera.local"),
        (f"http://user:a/{PASSWORD}@camera.local", "http://***@camera.local"),
        (f"http://user:{PASSWORD}@{PASSWORD}@camera.local", "http://***@camera.local"),
        (f"user:{PASSWORD}@camera.local", "***@camera.local"),
        (f"http://camera.local/?token={PASSWORD}", "http://camera.local/?***"),
    ],
)
def test_address_is_shown_without_its_password(address: str, shown: str) -> None:
    assert masked(address) == shown


async def test_password_is_sent_and_not_shown(
    daemon: Daemon, kind: type, caplog: pytest.LogCaptureFixture
) -> None:
    url = f"http://user:{PASSWORD}%21@localhost:1/"
    camera = camera_of(kind, daemon, url=url, max_retries=0)
    assert repr(camera) == f"{kind.__name__}('http://***@localhost:1/')"
    with caplog.at_level(logging.DEBUG):
        await result(camera.status())
    daemon.first = [httpx.ConnectError("refused"), httpx.ReadTimeout("slow")]
    shown = [caplog.text, repr(vars(camera)), repr(camera._transport.options)]
    for _ in range(2):
        with pytest.raises(VeilcamError, match=r"http://\*\*\*@localhost:1") as caught:
            await result(camera.status())
        shown += [str(caught.value), repr(caught.value), repr(caught.value.__cause__)]
    assert PASSWORD not in "".join(shown)
    sent = daemon.requests[0].headers["authorization"]
    assert sent == f"Basic {base64.b64encode(f'user:{PASSWORD}!'.encode()).decode()}"


@pytest.mark.parametrize(
    "address",
    ["ftp://user:{}@h", "http://user:{}@", "http://user:a/{}@h", "user:{}@h", "http://h?key={}"],
)
def test_password_of_an_address_that_is_refused_is_not_shown(kind: type, address: str) -> None:
    with pytest.raises(ValueError, match="url = ") as caught:
        kind(address.format(PASSWORD))
    assert PASSWORD not in str(caught.value)


def test_password_is_not_shown_beside_a_token_or_on_a_terminal() -> None:
    with pytest.raises(ValueError, match="in the clear") as caught:
        Camera(f"http://user:{PASSWORD}@camera.local", token="vc_1")
    assert PASSWORD not in str(caught.value)
    for place in ("127.0.0.1:9", "host:x"):
        told = CliRunner().invoke(app, ["status", "--url", f"http://user:{PASSWORD}@{place}"])
        assert told.exit_code != 0
        assert PASSWORD not in told.output
