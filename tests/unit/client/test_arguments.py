"""Arguments that cannot be used: one kind of error, which names the argument."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from tests.unit.client.conftest import Daemon, camera_of, problem, result
from tests.unit.client.sealing import Device, Epoch

from veilcam_client import (
    AsyncCamera,
    Camera,
    VeilcamError,
    collect,
    fetch_log,
    labelled_pictures,
    read_recording,
    record,
    verify_log,
)
from veilcam_client.errors import AccessError, ArgumentError, ProtocolError, SealedError
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.models import EverySeconds

pytestmark = pytest.mark.anyio
NO_SECONDS = ("5", True, 0, -1.0, math.nan, b"5", [5], 5j)
NO_COUNTS = ("5", True, -1, 1.5, math.nan, None)
NO_FLAGS = ("no", 1, None)
NO_NAMES = (None, 5, "", ".", "..", b"x")


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("url", (5, b"http://localhost", "", "localhost", "http://", "http://h:x", "http://[::1")),
        ("url", ("http://h:99999", "http://h\n", "unix:///a\0b", "http://h:0", "ftp://camera")),
        ("url", ("unix://relative/path", "http://camera?token=1")),
        ("timeout", NO_SECONDS),
        ("connect_timeout", (*NO_SECONDS, None)),
        ("read_timeout", (*NO_SECONDS, None)),
        ("max_retries", NO_COUNTS),
        ("key", (5, b"key")),
        ("device", ("ab" * 32,)),
        ("token", (5, b"vc_1", "", "vc 1")),
        ("ca_file", (5, b"x.pem", "no\0file")),
        ("http_client", (5, "httpx", httpx.Client)),
    ],
)
def test_argument_of_a_camera_is_named(kind: type, name: str, values: tuple[Any, ...]) -> None:
    for value in values:
        with pytest.raises(ArgumentError, match=rf"\b{name}\b"):
            kind(**{name: value})


def test_client_of_the_other_kind_is_named(daemon: Daemon) -> None:
    transport = httpx.MockTransport(daemon)
    with pytest.raises(ArgumentError, match="http_client cannot be a AsyncClient"):
        Camera(http_client=httpx.AsyncClient(transport=transport))  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="http_client cannot be a Client"):
        AsyncCamera(http_client=httpx.Client(transport=transport))  # type: ignore[arg-type]


def test_device_is_named(tmp_path: Path) -> None:
    ReceiverKey.generate().write(tmp_path / "key")
    for device in (5, "camera", b"ab" * 32):
        with pytest.raises(ArgumentError, match="device is not valid"):
            Camera(key=tmp_path / "key", device=device)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("method", "given", "name", "values"),
    [
        ("status", {}, "timeout", NO_SECONDS),
        ("capture", {}, "wait", ("5", True, -1, math.nan)),
        ("classify", {}, "include_embedding", NO_FLAGS),
        ("calibration.start", {}, "repeats", (*NO_COUNTS, 0)),
        ("calibration.confirm", {}, "scene", ("night", None, 5)),
        ("rotation.set", {}, "policy", ({"mode": "off"}, None, "off", EverySeconds)),
        ("watch.set", {}, "policy", ({"mode": "off"}, None, EverySeconds(seconds=7))),
        ("simulation.set_faults", {}, "faults", ({}, None, True)),
        ("lease.take", {}, "seconds", (*NO_SECONDS, 3601, math.inf)),
        ("lease.take", {"seconds": 5}, "owner", ("", 5, None, "\n")),
        ("tokens.list", {}, "limit", (*NO_COUNTS, 0, 1001)),
        ("tokens.list", {}, "after", NO_NAMES[1:]),
        ("log.list", {}, "limit", (*NO_COUNTS, 0)),
        ("log.list", {}, "after", NO_COUNTS[:-1]),
        ("tokens.create", {"scopes": ["classify"]}, "label", ("", 5, None)),
        ("tokens.create", {"label": "a"}, "scopes", ("classify", [], ["all"], None, 5)),
        ("tokens.create", {"label": "a", "scopes": ["classify"]}, "seconds", ("5", 0, True, 1.5)),
        ("tokens.revoke", {}, "token_id", NO_NAMES),
        ("receivers.add", {"label": "a"}, "key", (5, None, "", "private")),
        ("receivers.add", {"key": "veilcam-receiver:aaaa"}, "label", ("", 5)),
        ("receivers.remove", {}, "receiver_id", NO_NAMES),
        ("receivers.offer", {}, "role", ("king", None, 5)),
        ("receivers.claim", {"label": "a", "key": "veilcam-receiver:aaaa"}, "secret", ("0f", 5)),
        ("tokens.create", {"label": "a"}, "role", ("king", None, 5)),
        (
            "simulation.hold_scene",
            {},
            "picture",
            ("a.png", Path("a.png"), 5, b"", b"abcd", {}, [[1], [1, 2]]),
        ),
        ("bundles.install", {}, "bundle", ("a.veilcam", Path("a.veilcam"), None, 5)),
        ("bundles.activate", {}, "digest", NO_NAMES),
        ("bundles.activate", {"digest": "ab"}, "allow_older", NO_FLAGS),
        ("bundles.remove", {}, "digest", NO_NAMES),
        ("events", {}, "last_event_id", (5, b"b-1", "b\n1", "b-\xe9")),
        ("events", {}, "reconnect", NO_FLAGS),
        ("discover", {}, "seconds", (*NO_SECONDS, 601)),
    ],
)
async def test_argument_of_a_method_is_named(  # noqa: PLR0917 - a table
    daemon: Daemon,
    kind: type,
    method: str,
    given: dict[str, Any],
    name: str,
    values: tuple[Any, ...],
) -> None:
    camera = camera_of(kind, daemon)
    for value in values:
        with pytest.raises(ArgumentError, match=rf"\b{name}\b") as caught:
            await result(attrgetter(method)(camera)(**given, **{name: value}))
        assert caught.value.code == "invalid_argument"
        assert "\n" not in str(caught.value)
    assert not daemon.requests


def test_numbers_of_numpy_are_numbers(daemon: Daemon) -> None:
    camera = camera_of(Camera, daemon, timeout=np.float32(5), max_retries=np.int64(1))
    assert camera.status(timeout=np.int32(5)).state == "ready"
    assert camera.simulation.hold_scene(np.zeros((2, 2), np.uint8)).scene == 1


async def test_time_without_an_end_is_a_time(daemon: Daemon, url: str, kind: type) -> None:
    endless = math.inf
    camera = kind(url, timeout=endless, connect_timeout=endless, read_timeout=endless)
    assert (await result(camera.status(timeout=1e300))).state == "ready"
    await result(camera.close())


def test_key_of_a_receiver_is_not_repeated(daemon: Daemon) -> None:
    with pytest.raises(ArgumentError, match="key is not valid") as caught:
        camera_of(Camera, daemon).receivers.add("a", "veilcam-receiver-private-key:c2VjcmV0")
    assert "c2VjcmV0" not in str(caught.value)


async def test_camera_that_is_closed_says_so(daemon: Daemon, url: str, kind: type) -> None:
    for camera in (kind(url), camera_of(kind, daemon)):
        await result(camera.status())
        await result(camera.close())
        await result(camera.close())
        events = camera.events()
        step = events.__next__ if kind is Camera else events.__anext__
        for ask in (camera.status, partial(camera.raw, camera.status), step):
            with pytest.raises(ArgumentError, match="the camera is closed"):
                await result(ask())


async def test_client_that_is_closed_is_named(daemon: Daemon) -> None:
    client = httpx.Client(transport=httpx.MockTransport(daemon))
    camera = Camera(http_client=client)
    client.close()
    with pytest.raises(ArgumentError, match="http_client is closed"):
        camera.status()


def test_file_of_a_function_is_named(daemon: Daemon, tmp_path: Path) -> None:
    camera = camera_of(Camera, daemon)
    name, new = "a file", tmp_path / "new"
    calls: list[tuple[str, Callable[[Any], Any], Any]] = [
        ("path", read_recording, name),
        ("path", lambda value: record(camera, value, count=1), name),
        *(("count", lambda value: record(camera, new, count=value), n) for n in (*NO_COUNTS, 0)),
        ("path", lambda value: collect(camera, value, []), name),
        ("folder", labelled_pictures, name),
        ("per_class", lambda value: labelled_pictures(tmp_path, per_class=value), 0),
        ("path", lambda value: fetch_log(camera, value), name),
        ("content", verify_log, name),
        ("head", lambda value: verify_log(b"", head=value), name),
        ("answer", lambda value: verify_log(b"", answer=value), name),
    ]
    for argument, call, value in calls:
        with pytest.raises(ArgumentError, match=rf"\b{argument}\b"):
            call(value)
    assert not new.exists()


def test_sealed_embedding_says_what_opens_it() -> None:
    sealed = Epoch(Device(), ReceiverKey.generate()).capture(0).embedding
    uses: tuple[Callable[[Any], Any], ...] = (len, list, np.asarray)
    by_index: tuple[Callable[[Any], Any], ...] = (lambda each: each[0], lambda each: each[0, 1])
    inside: Callable[[Any], Any] = lambda each: 1 in each  # noqa: E731
    for use in (*uses, *by_index, inside):
        with pytest.raises(SealedError, match=r"Camera\(key=\.\.\.\)"):
            use(sealed)
    assert sealed
    assert sealed.model_dump()["form"] == "sealed"


async def test_missing_token_is_named(daemon: Daemon, kind: type) -> None:
    refused: list[tuple[httpx.Response, type[VeilcamError]]] = [
        (problem(401, "unauthorized"), AccessError),
        (httpx.Response(401, text="of a proxy"), ProtocolError),
    ]
    for answer, error in refused:
        daemon.first = [answer]
        with pytest.raises(error, match=r"token= or in VEILCAM_TOKEN"):
            await result(camera_of(kind, daemon).status())
