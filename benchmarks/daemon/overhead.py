"""What the daemon adds to the device's own time, as eight clients see it.

    python -m benchmarks.daemon.overhead --figures benchmarks/results/daemon.json

Run it on a quiet machine: the figures are of milliseconds, and a busy scheduler adds as many.

A real daemon serves a simulated device that settles and exposes in no time, over TCP on loopback;
its mask stays. Clients, each with a connection of its own, ask for one classification after the
other. The *overhead* of a request is what its client waited, less what the device was at work
meanwhile, for this request and for those before it in the queue: ``queue_s + rotation_s + settle_s
+ capture_s`` of its timing. Timings leave a daemon only in the notes that are sealed with an
embedding, so that every request asks for its embedding too, and the clients are a receiver that the
daemon was paired with. Inference, sealing, the queue's own delays, threads, JSON, HTTP and the
network count as overhead. The simulator's light takes a few ms for a capture; that is device time.

It is measured twice: by plain clients (``http.client``), from the request's first byte to the
answer's last, which is what the daemon costs; and by clients of the SDK, which adds what they cost,
opening included.
"""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from http.client import HTTPConnection
from typing import Annotated
from urllib.parse import urlsplit

import numpy as np
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.rig import pair, prompt_daemon, work_folder

from veilcam_client import AsyncCamera, Camera
from veilcam_client.keys.blocks import Opener
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.models import RotationOff
from veilcam_client.wire.captures import Classification, ClassificationRequest, Timing

WARM_UP = 5
"""Requests of each client that do not count."""
QUESTION = ClassificationRequest(include_embedding=True).model_dump_json()


@dataclass(frozen=True)
class Request:
    """One classification: what its client waited [s], and where its notes say it went."""

    waited: float
    timing: Timing

    @property
    def device(self) -> float:
        """The device at work, for this request and for those before it [s]."""
        timing = self.timing
        return timing.queue_s + timing.rotation_s + timing.settle_s + timing.capture_s

    @property
    def overhead(self) -> float:
        """What the daemon, the network and the client add to that [s]."""
        return self.waited - self.device


def ask_plainly(url: str, count: int) -> list[tuple[float, bytes]]:
    """Classify ``count`` times, one after the other, as one client that does nothing else.

    Returns:
        What it waited [s], and the answer.
    """
    parts = urlsplit(url)
    connection = HTTPConnection(str(parts.hostname), parts.port)
    headers, answers = {"Content-Type": "application/json"}, []
    try:
        for _ in range(WARM_UP + count):
            begun = time.perf_counter()
            connection.request("POST", "/v1/classifications", QUESTION, headers)
            body = connection.getresponse().read()
            answers.append((time.perf_counter() - begun, body))
    finally:
        connection.close()
    return answers[WARM_UP:]


def plain_clients(url: str, key: ReceiverKey, clients: int, count: int) -> list[Request]:
    """Ask as many plain clients at the same time, ``count`` requests each."""
    with ThreadPoolExecutor(clients) as pool:
        asked = list(pool.map(lambda _: ask_plainly(url, count), range(clients)))
    # Opened only now: while others wait for their answers, it would be their overhead.
    return [request for answers in asked for request in opened(answers, Opener(key))]


def opened(answers: Sequence[tuple[float, bytes]], opener: Opener) -> Iterator[Request]:
    """Find in each answer of one client what its notes say of the device."""
    for waited, body in answers:
        yield Request(waited, timing_of(opener.open(Classification.model_validate_json(body))))


def timing_of(answer: Classification) -> Timing:
    """Timing in the notes of an answer that was opened."""
    if answer.notes is None:
        raise RuntimeError("an answer came without its notes: is the receiver paired?")
    return answer.notes.timing


async def ask(url: str, key: ReceiverKey, count: int) -> list[Request]:
    """As :func:`ask_plainly`, with the SDK."""
    requests = []
    async with AsyncCamera(url, key=key) as camera:
        for _ in range(WARM_UP + count):
            begun = time.perf_counter()
            answer = await camera.classify(include_embedding=True)
            requests.append(Request(time.perf_counter() - begun, timing_of(answer)))
    return requests[WARM_UP:]


def sdk_clients(url: str, key: ReceiverKey, clients: int, count: int) -> list[Request]:
    """As :func:`plain_clients`, with the SDK."""

    async def ask_all() -> list[list[Request]]:
        return await asyncio.gather(*(ask(url, key, count) for _ in range(clients)))

    return [request for requests in asyncio.run(ask_all()) for request in requests]


def describe(requests: Sequence[Request]) -> None:
    """Print median, 95 % and 99 % of every part."""
    parts: dict[str, Callable[[Request], float]] = {
        "overhead": lambda request: request.overhead,
        "device": lambda request: request.device,
        "  of it queue": lambda request: request.timing.queue_s,
        "  of it capture": lambda request: request.timing.capture_s,
        "client waited": lambda request: request.waited,
    }
    print(f"{'[ms]':24}{'median':>9}{'95 %':>9}{'99 %':>9}")
    for name, part in parts.items():
        found = np.percentile([1e3 * part(request) for request in requests], (50, 95, 99))
        print(f"{name:24}" + "".join(f"{value:9.2f}" for value in found))


def main(
    *,
    clients: Annotated[int, typer.Option(min=1, help="At the same time.")] = 8,
    count: Annotated[int, typer.Option(min=1, help="Requests of each client.")] = 500,
    figures: FiguresOption = None,
) -> None:
    """Measure what a classification costs beyond the device's own time."""
    # All clients are one peer, and ask as often as they can: none is to be refused.
    options = ("--callers", "1024")
    values: dict[str, float] = {}
    with work_folder() as folder, prompt_daemon(folder, *options) as url:
        with Camera(url) as camera:
            camera.rotation.set(RotationOff())
        key = pair(url)
        for name, measure in {"": plain_clients, "sdk_": sdk_clients}.items():
            begun = time.perf_counter()
            requests = measure(url, key, clients, count)
            rate = clients * (WARM_UP + count) / (time.perf_counter() - begun)
            load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
            print(
                f"{len(requests)} requests of {clients} {'SDK' if name else 'plain'} clients, "
                f"{rate:.0f} a second; load {load}"
            )
            describe(requests)
            overheads = [1e3 * request.overhead for request in requests]
            median, last = np.percentile(overheads, (50, 99))
            values[f"overhead_{name}median_ms"] = round(float(median), 3)
            values[f"overhead_{name}p99_ms"] = round(float(last), 3)
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
