"""Fifty listeners to the events of a daemon at work: none may miss, repeat or reorder one.

    python -m benchmarks.daemon.sse --figures benchmarks/results/daemon.json

A real daemon on a simulated device classifies at an even pace, which makes two events each time.
Every listener is a client of the SDK with a connection of its own. One listener more opens the
stream and does not read until the end: it must slow nobody, and whatever the kernel's buffers do
not hold for it must stand in its stream as a gap of that many events.
"""

from __future__ import annotations

import asyncio
import os
import socket
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Annotated
from urllib.parse import urlsplit

import httpx
import numpy as np
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.rig import prompt_daemon, work_folder
from httpx_sse import EventSource

from veilcam_client import AsyncCamera
from veilcam_client.wire.events import EVENT, Event, Gap, RotationChanged
from veilcam_client.wire.rotation import EveryCaptures, RotationOff

PATIENCE = 30.0
"""Longest wait for the last event [s]."""
LAST = EveryCaptures(captures=999_999)
"""A policy that is set to mark the end."""


def number(event: Event) -> int:
    """Place of an event in the order in which the daemon made them."""
    return int(event.id.partition("-")[2])


@dataclass
class Heard:
    """What one listener heard."""

    events: int = 0
    told: int = 0
    """Events that the daemon said were missed."""
    silent: int = 0
    """Events that were missed without a word."""
    repeated: int = 0
    """Events that came twice, or after a later one."""
    delays: list[float] = field(default_factory=list)
    """From the daemon's clock to the listener's [s]."""
    last: int | None = None

    def hear(self, event: Event) -> None:
        """Count one event."""
        place = number(event)
        if isinstance(event, Gap):
            # Its number is that of the last one missed.
            self.told += event.missed or 1
            if self.last is not None:
                self.silent += abs(place - self.last - (event.missed or 0))
        else:
            self.events += 1
            self.delays.append(time.time() - event.at.timestamp())
            if self.last is not None and place != self.last + 1:
                self.repeated += place <= self.last
                self.silent += max(0, place - self.last - 1)
        self.last = place if self.last is None else max(self.last, place)


async def listen(url: str, heard: Heard) -> None:
    """Hear events until the last one."""
    async with AsyncCamera(url, max_retries=0) as camera:
        async for event in camera.events():
            heard.hear(event)
            if is_last(event):
                return


def is_last(event: Event) -> bool:
    """Whether this is the event that ends the measurement."""
    return isinstance(event, RotationChanged) and event.policy == LAST


class SlowListener:
    """Opens the stream and reads nothing until it is told; keeps the kernel's buffer small."""

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        assert parts.hostname is not None
        self._socket = socket.socket()
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        self._socket.settimeout(PATIENCE)
        self._socket.connect((parts.hostname, parts.port))
        self._socket.sendall(b"GET /v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n")

    def read(self) -> Heard:
        """Read everything, up to the last event."""
        heard, headers = Heard(), {"Content-Type": "text/event-stream; charset=utf-8"}
        with self._socket:
            stream = httpx.Response(200, headers=headers, content=self._chunks())
            for message in EventSource(stream).iter_sse():
                if message.data:
                    event = EVENT.validate_json(message.data)
                    heard.hear(event)
                    if is_last(event):
                        return heard
        raise RuntimeError("the stream ended before its last event")

    def _chunks(self) -> Iterator[bytes]:
        """Bodies of HTTP chunks, without their lengths."""
        with self._socket.makefile("rb") as stream:
            while stream.readline().strip():
                pass
            while length := int(stream.readline(), 16):
                yield stream.read(length)
                stream.readline()


async def work(camera: AsyncCamera, rate: float, seconds: float) -> int:
    """Classify at an even pace that makes ``rate`` events a second; return how often."""
    begun, count = time.monotonic(), 0
    while (now := time.monotonic() - begun) < seconds:
        await asyncio.sleep(max(0.0, 2 * count / rate - now))
        await camera.classify()
        count += 1
    return count


async def measure(
    url: str, listeners: int, rate: float, seconds: float
) -> tuple[list[Heard], Heard, float]:
    """Let listeners hear a daemon at work; return what all heard, the slow one, and the rate."""
    heard = [Heard() for _ in range(listeners)]
    slow = SlowListener(url)
    async with AsyncCamera(url) as camera, asyncio.TaskGroup() as group:
        listening = [group.create_task(listen(url, one)) for one in heard]
        # Each listener counts from the first event that it hears.
        while any(one.last is None for one in heard):
            await camera.rotation.set(RotationOff())
            await asyncio.sleep(0.1)
        begun, first = time.monotonic(), heard[0].events
        await work(camera, rate, seconds)
        took = time.monotonic() - begun
        await camera.rotation.set(LAST)
        await asyncio.wait(listening, timeout=PATIENCE)
        for task in listening:
            task.cancel()
    return heard, await asyncio.to_thread(slow.read), (heard[0].events - first) / took


def missing(heard: Sequence[Heard]) -> int:
    """Events missed or repeated, over all listeners; one that never heard the end counts too."""
    end = max(one.last or 0 for one in heard)
    return sum(one.told + one.silent + one.repeated + (one.last != end) for one in heard)


def main(
    *,
    listeners: Annotated[int, typer.Option(min=1, help="At the same time.")] = 50,
    rate: Annotated[float, typer.Option(min=1, help="Events a second.")] = 30.0,
    seconds: Annotated[float, typer.Option(min=0.1, help="How long.")] = 90.0,
    figures: FiguresOption = None,
) -> None:
    """Look for events that a listener missed, heard twice or in another order."""
    with work_folder() as folder, prompt_daemon(folder) as url:
        heard, slow, reached = asyncio.run(measure(url, listeners, rate, seconds))
    delays = [1e3 * delay for one in heard for delay in one.delays]
    middle, last = np.percentile(delays, (50, 99))
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    print(
        f"{listeners} listeners, {reached:.1f} events a second, {len(delays)} heard; "
        f"{missing(heard)} missed or repeated; load {load}"
    )
    print(f"from daemon to listener: median {middle:.1f} ms, 99 % {last:.1f} ms")
    print(
        f"who did not read: {slow.told} missed and told so, {slow.silent} without a word, "
        f"{slow.repeated} repeated"
    )
    record(figures, {"sse_gaps": missing(heard)})
    if missing(heard) or slow.repeated or slow.silent:
        raise SystemExit(1)


if __name__ == "__main__":
    typer.run(main)
