"""Cameras after a fork: a process that was forked asks over connections of its own."""

from __future__ import annotations

import asyncio
import gc
import json
import os
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest
from tests.unit.client.conftest import STATUS, Daemon, Handler, camera_of, result, serving

from veilcam_client import AsyncCamera, Camera
from veilcam_client.errors import ArgumentError
from veilcam_client.wire.base import CALL_HEADER

# From Python 3.12 on, a fork beside a thread is warned of: here that is the case to be tried.
pytestmark = pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
ENOUGH = 60.0


@dataclass
class Heard:
    """Requests by the port of their connection, and what slow ones wait for."""

    url: str = ""
    ports: list[int] = field(default_factory=list)
    went_on_after: list[str | None] = field(default_factory=list)
    slow: threading.Event = field(default_factory=threading.Event)
    go: threading.Event = field(default_factory=threading.Event)


@pytest.fixture
def heard() -> Iterator[Heard]:
    """A daemon that keeps connections open. Its streams end with the second event."""
    heard = Heard()

    class Asked(Handler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:  # noqa: N802 - the name http.server looks for
            heard.ports.append(self.client_address[1])
            if self.path == "/v1/events":
                self.stream()
                return
            if self.path == "/v1/rotation":
                heard.slow.set()
                heard.go.wait(ENOUGH)
            content = json.dumps(STATUS).encode()
            self.head("application/json", **{"Content-Length": str(len(content))})
            self.wfile.write(content)

        def stream(self) -> None:
            last = self.headers.get("Last-Event-ID")
            heard.went_on_after.append(last)
            self.close_connection = True
            self.head("text/event-stream")
            self.wfile.write(event("e1") if last is None else event("e3"))
            heard.go.wait(ENOUGH)
            self.wfile.write(event("e2"))

        def head(self, media_type: str, **more: str) -> None:
            self.send_response(200)
            for name, value in {"Content-Type": media_type, **more}.items():
                self.send_header(name, value)
            self.send_header(CALL_HEADER, self.headers[CALL_HEADER])
            self.end_headers()

    with serving(Asked) as heard.url:
        yield heard
        heard.go.set()


def event(epoch: str) -> bytes:
    told = {"kind": "mask", "id": f"b-{epoch}", "at": "2026-01-02T03:04:05Z", "epoch": epoch}
    return f"event: mask\nid: {told['id']}\ndata: {json.dumps(told)}\n\n".encode()


def in_a_fork(work: Callable[[], object]) -> object:
    """What ``work`` returns in a process that is forked now, or the error that it raises."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            told = str(work())
        except BaseException as error:
            told = f"{type(error).__name__}: {error}"
        os.write(write, told.encode())
        os._exit(0)
    os.close(write)
    with os.fdopen(read, "rb") as pipe:
        told = pipe.read().decode()
    os.waitpid(child, 0)
    return told


@pytest.fixture
def within() -> Iterator[Callable[[Any], Any]]:
    """Run what either kind of camera answers in the loop of this process, to its end."""
    with asyncio.Runner() as runner:
        yield lambda answer: runner.run(result(answer))


def run(answer: Any) -> Any:
    """The same in another process, which has no loop of its own yet."""
    return asyncio.run(result(answer))


def test_forked_camera_opens_a_connection_of_its_own(
    heard: Heard, within: Callable[[Any], Any], kind: type
) -> None:
    camera = kind(heard.url)

    async def ask_and_close() -> str:
        await result(camera.status())
        state = (await result(camera.status())).state
        await result(camera.close())
        return str(state)

    within(camera.status())
    assert in_a_fork(lambda: run(ask_and_close())) == "ready"
    within(camera.status())
    # A camera that is only closed there has nothing to close.
    assert in_a_fork(lambda: run(camera.close())) == "None"
    within(camera.status())
    within(camera.close())
    parent, child = heard.ports[:2]
    assert parent != child
    assert heard.ports == [parent, child, child, parent, parent]


def test_forked_camera_needs_no_lock_of_the_parent(heard: Heard) -> None:
    with Camera(heard.url) as camera:

        def waits() -> None:
            with pytest.raises(Exception, match="Rotation"):
                camera.rotation.get()  # answered with another model, in the end

        asking = threading.Thread(target=waits)
        asking.start()
        assert heard.slow.wait(ENOUGH)
        # Held by a thread that the fork does not copy, as in the middle of opening a connection.
        with camera._transport.client._transport._pool._optional_thread_lock:  # type: ignore[attr-defined]
            assert in_a_fork(lambda: camera.status().state) == "ready"
        heard.go.set()
        asking.join()


def test_forked_stream_goes_on_over_a_connection_of_its_own(
    heard: Heard, within: Callable[[Any], Any], kind: type
) -> None:
    camera = kind(heard.url)
    stream = camera.events()

    async def epoch() -> str:
        return str((await result(next(stream) if kind is Camera else anext(stream))).epoch)

    async def follow_and_close() -> str:
        told = await epoch()
        await result(stream.close())
        return told

    assert within(epoch()) == "e1"
    assert in_a_fork(lambda: run(follow_and_close())) == "e3"
    # Closed there without a look: the parent's connection is not hung up.
    assert in_a_fork(lambda: run(stream.close())) == "None"
    heard.go.set()
    assert within(epoch()) == "e2"
    within(stream.close())
    within(camera.close())
    assert heard.went_on_after == [None, "b-e1"]
    assert len(set(heard.ports)) == 2


def test_client_of_the_caller_is_not_used_on_both_sides_of_a_fork(
    daemon: Daemon, within: Callable[[Any], Any], kind: type
) -> None:
    camera = camera_of(kind, daemon)
    # Not used yet, it belongs to whoever uses it first.
    assert in_a_fork(lambda: run(camera.status()).state) == "ready"
    within(camera.status())
    told = in_a_fork(lambda: run(camera.status()))
    assert str(told).startswith(f"{ArgumentError.__name__}: http_client was used before")
    within(camera.status())


# What is left open on the first loop can be closed by nobody.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_async_camera_follows_its_caller_to_another_loop(heard: Heard) -> None:
    camera = AsyncCamera(heard.url)
    first = asyncio.Runner()
    with first, asyncio.Runner() as second:
        first.run(camera.status())
        second.run(camera.status())
        second.run(camera.status())
        second.run(camera.close())
    one, two, three = heard.ports
    assert one != two == three
    del camera, first, second
    gc.collect()  # what was left open warns in this test, and in no later one
