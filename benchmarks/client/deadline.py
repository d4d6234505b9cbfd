"""How well the SDK keeps the deadline of a call, whatever the server does.

    python -m benchmarks.client.deadline --figures benchmarks/results/people.json

100 servers are drawn by chance (``hostile.py``). Each is asked once by a ``Camera`` and once by an
``AsyncCamera``, with a deadline of 0.1 to 0.4 s and a read time-out of 0.2 s. A deadline is kept if
the call ends at the latest one read time-out after it, and with an error of the SDK. Run it on a
quiet machine: what the scheduler takes is counted as the SDK's.
"""

from __future__ import annotations

import asyncio
import time
from typing import Annotated

import numpy as np
import typer
from benchmarks.client.hostile import Hostile, draw
from benchmarks.figures import FiguresOption, record

from veilcam_client import AsyncCamera, Camera, VeilcamError

SEED = 20
READ = 0.2
"""Longest wait for the next piece of an answer [s]."""


def ask(server: Hostile) -> tuple[float, str]:
    """Ask a server; return what the call took [s], and the kind of its error."""
    with server.serving() as url, Camera(url, timeout=server.deadline, read_timeout=READ) as camera:
        begun = time.perf_counter()
        try:
            camera.status()
        except VeilcamError as error:
            return time.perf_counter() - begun, type(error).__name__
    raise RuntimeError(f"a server that {server.kind!r} was taken for a camera")


def ask_async(server: Hostile) -> tuple[float, str]:
    """As :func:`ask`, with ``AsyncCamera``."""

    async def asked(url: str) -> tuple[float, str]:
        async with AsyncCamera(url, timeout=server.deadline, read_timeout=READ) as camera:
            begun = time.perf_counter()
            try:
                await camera.status()
            except VeilcamError as error:
                return time.perf_counter() - begun, type(error).__name__
        raise RuntimeError(f"a server that {server.kind!r} was taken for a camera")

    with server.serving() as url:
        return asyncio.run(asked(url))


def kept(server: Hostile, took: float) -> bool:
    """Whether a call ended in time."""
    return took <= server.deadline + READ


def main(
    *,
    count: Annotated[int, typer.Option(min=1, help="Servers.")] = 100,
    figures: FiguresOption = None,
) -> None:
    """Measure in how many of hostile servers the deadline is kept."""
    late, overtime = 0, []
    for server in draw(count, SEED):
        for name, asked in {"sync": ask, "async": ask_async}.items():
            took, error = asked(server)
            overtime.append(took - server.deadline)
            if not kept(server, took):
                late += 1
                print(f"{name}: {server} took {took:.3f} s ({error})")
    fraction = 1 - late / (2 * count)
    most, median = np.max(overtime), np.median(overtime)
    print(f"kept in {fraction:.3f} of {2 * count} calls; latest {1e3 * most:.1f} ms after the")
    print(f"deadline, median {1e3 * median:.1f} ms")
    record(figures, {"deadline_kept_fraction": round(fraction, 4)})


if __name__ == "__main__":
    typer.run(main)
