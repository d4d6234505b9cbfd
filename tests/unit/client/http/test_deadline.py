"""Deadlines, against servers that no client should wait for."""

from __future__ import annotations

import asyncio
import socket
import ssl
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import httpcore
import httpx
import pytest
from benchmarks.client.hostile import KINDS, Hostile, draw
from tests.unit.client.conftest import result

from veilcam_client import AsyncCamera, Camera, VeilcamError
from veilcam_client.errors import ConnectError, DeviceError, ProtocolError, RequestTimeoutError
from veilcam_client.http.deadline import Limit
from veilcam_client.http.sockets import _Backend

OUTCOMES = (RequestTimeoutError, ProtocolError, ConnectError, DeviceError)
PATIENT = 60.0
"""Of a client that would wait long for one more byte [s]."""


def ask(server: Hostile, kind: type = Camera) -> VeilcamError:
    """Ask a server that ends only after the call: that it returns at all is the deadline's work."""

    async def status(url: str) -> VeilcamError:
        camera = kind(url, timeout=server.deadline, read_timeout=PATIENT)
        with pytest.raises(VeilcamError) as caught:
            await result(camera.status())
        await result(camera.close())
        return caught.value

    with server.serving() as url:
        return asyncio.run(status(url))


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.timeout(120)
def test_hostile_servers_hold_nobody_up(*, long_form: bool) -> None:
    servers = draw(100 if long_form else len(KINDS) + 5, seed=1)
    assert {server.kind for server in servers} == set(KINDS)
    with ThreadPoolExecutor(8) as pool:
        errors = list(pool.map(ask, servers))
        errors += pool.map(lambda server: ask(server, AsyncCamera), servers)
    for server, error in zip(servers * 2, errors, strict=True):
        assert isinstance(error, OUTCOMES), server
        if not server.secure and server.kind.startswith(("dribbles", "falls silent", "silent")):
            assert isinstance(error, RequestTimeoutError), server


@pytest.mark.parametrize("kind", ["100 MB", "100 MB in chunks", "says it is compressed"])
@pytest.mark.slow
def test_endless_answer_is_not_read_to_its_end(kind: str) -> None:
    server = Hostile(kind, deadline=PATIENT, pause=0.01, secure=False)
    for error in (ask(server), ask(server, AsyncCamera)):
        assert isinstance(error, ProtocolError)


@contextmanager
def deaf() -> Iterator[str]:
    """URL of a server that reads nothing of what it is sent."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"


def test_upload_that_nobody_reads_ends_too() -> None:
    upload = b"x" * 2**24
    with (
        deaf() as url,
        Camera(url, read_timeout=PATIENT) as camera,
        pytest.raises(RequestTimeoutError),
    ):
        camera.bundles.install(upload, timeout=0.2)


def test_socket_is_closed_where_no_time_is_left_for_tls() -> None:
    with deaf() as url:
        address = url.removeprefix("http://").split(":")
        stream = _Backend().connect_tcp(address[0], int(address[1]))
        bare = stream.get_extra_info("socket")
        with pytest.raises(httpcore.ConnectTimeout):
            stream.start_tls(ssl.create_default_context(), timeout=Limit.of(1.0, until=0.0))
    assert bare.fileno() == -1


def test_limit_is_a_number_that_knows_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr("veilcam_client.http.deadline.time.monotonic", lambda: now)
    limit = Limit.of(5.0, until=103.0)
    assert (limit, limit.left()) == (3.0, 3.0)
    now = 102.0
    assert (limit, limit.left()) == (3.0, 1.0)
    now = 104.0
    assert limit.left() == -1.0
    assert Limit.of(5.0, until=103.0) == 0.0
    assert Limit.of(5.0, until=1e9).left() == 5.0


def test_client_that_was_handed_in_asks_between_two_pieces() -> None:
    server = Hostile("dribbles a body", deadline=0.1, pause=0.01, secure=False)
    with server.serving() as url, httpx.Client() as client, pytest.raises(RequestTimeoutError):
        Camera(url, http_client=client, timeout=0.1).status()
