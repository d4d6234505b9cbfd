"""What the SDK adds to a bare httpx client, and arrays to JSON.

    python -m benchmarks.client.overhead --figures benchmarks/results/people.json

A server of constant answers listens on loopback, in a process of its own. ``Camera`` and a bare
``httpx.Client`` classify in turn over connections of their own; the *overhead* is the difference of
the medians, by the clock and of the processor in this process: on a busy machine the clock also
counts what others take. The bare one parses the answer as JSON: a model, retries, a deadline and a
log are what the SDK adds.

1,000 embeddings of 24 x 32 are taken as NumPy files and as JSON. ``npy_over_json`` is what JSON
takes over what NumPy takes *in the SDK*: from the bytes of an answer to the array, a hundred of one
form after the other, as a program reads them, and the forms in turn. What the connection takes is
the same for both, and with it, one ``Camera.capture`` of each form in turn, the ratio is
``npy_over_json_with_http``. Both are of the processor.
"""

from __future__ import annotations

import io
import json
import multiprocessing
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Annotated, TypeAlias

import httpx
import numpy as np
import numpy.typing as npt
import typer
from benchmarks.figures import FiguresOption, record

from veilcam_client import Camera
from veilcam_client.http.answers import Received, read
from veilcam_client.models import Capture, Classification, Embedding
from veilcam_client.wire.captures import NPY_MEDIA_TYPE

SHAPE = (24, 32)
WARM_UP = 50
"""Requests that do not count."""
RUN = 100
"""Answers of one form that are read one after the other."""
_TIME = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
_VALUES = np.random.default_rng(20).normal(size=SHAPE).astype(np.float32)
_CAPTURE = Capture(
    id="c0ffee00" * 6,
    epoch="9f" * 16,
    number=3,
    taken_at=_TIME,
    embedding=Embedding.from_array(_VALUES),
)
_CLASSIFICATION = Classification(
    id="c0ffee00" * 6,
    epoch="9f" * 16,
    number=3,
    taken_at=_TIME,
    label="7",
    confidence=0.91,
    scores={str(digit): 0.91 if digit == 7 else 0.01 for digit in range(10)},
)
Times: TypeAlias = npt.NDArray[np.float64]


def answers() -> dict[str, Received]:
    """A classification, and a capture in both forms."""
    file = io.BytesIO()
    np.save(file, _VALUES)
    names = {
        "veilcam-capture": _CAPTURE.id,
        "veilcam-epoch": _CAPTURE.epoch,
        "veilcam-number": str(_CAPTURE.number),
        "veilcam-taken-at": _TIME.isoformat(),
        "veilcam-form": "raw",
    }
    as_json = {"content-type": "application/json"}
    return {
        "classification": Received(200, as_json, _CLASSIFICATION.model_dump_json().encode()),
        "json": Received(200, as_json, _CAPTURE.model_dump_json().encode()),
        "npy": Received(200, {**names, "content-type": NPY_MEDIA_TYPE}, file.getvalue()),
    }


def _serve(listener: socket.socket) -> None:
    """Answer every request of the connections that come, one thread for all: they take turns."""
    said = {
        name: b"".join(
            (
                b"HTTP/1.1 200 OK\r\n",
                *(f"{key}: {value}\r\n".encode() for key, value in answer.headers.items()),
                b"content-length: %d\r\n\r\n%s" % (len(answer.content), answer.content),
            )
        )
        for name, answer in answers().items()
    }
    import selectors  # noqa: PLC0415 - of the server's process alone

    ready = selectors.DefaultSelector()
    ready.register(listener, selectors.EVENT_READ)
    while True:
        for key, _ in ready.select():
            if key.fileobj is listener:
                connection, _ = listener.accept()
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                ready.register(connection, selectors.EVENT_READ)
                continue
            connection = key.fileobj  # type: ignore[assignment]
            request = connection.recv(65_536)
            if not request:
                ready.unregister(connection)
                connection.close()
            elif b"/json/" in request:
                connection.sendall(said["json"])
            else:
                captures = request.startswith(b"POST /v1/captures")
                connection.sendall(said["npy" if captures else "classification"])


@contextmanager
def server() -> Iterator[str]:
    """Yield the URL of a server of constant answers; under ``/json`` captures come as JSON."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        process = multiprocessing.get_context("fork").Process(
            target=_serve, args=(listener,), daemon=True
        )
        process.start()
        try:
            yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        finally:
            process.terminate()
            process.join()


def in_turn(count: int, *asks: Callable[[], object]) -> tuple[Times, Times]:
    """Medians of what each takes, one after the other so that all meet the same machine.

    Returns:
        By the clock, and of the processor in this process [s].
    """
    wall, busy = (np.empty((WARM_UP + count, len(asks))) for _ in range(2))
    for turn in range(WARM_UP + count):
        for place, ask in enumerate(asks):
            begun, idle = time.perf_counter(), time.thread_time()
            ask()
            busy[turn, place] = time.thread_time() - idle
            wall[turn, place] = time.perf_counter() - begun
    return np.median(wall[WARM_UP:], axis=0), np.median(busy[WARM_UP:], axis=0)


def overhead(url: str, count: int) -> tuple[float, float]:
    """What ``Camera`` adds to bare httpx: by the clock, and of the processor [s]."""
    with Camera(url) as camera, httpx.Client(trust_env=False) as client:

        def bare() -> object:
            response = client.post(f"{url}/v1/classifications")
            response.raise_for_status()
            return json.loads(response.content)

        wall, busy = in_turn(count, camera.classify, bare)
    print(f"classify: SDK {1e3 * wall[0]:.3f} ms, bare httpx {1e3 * wall[1]:.3f} ms")
    print(f"of the processor: SDK {1e3 * busy[0]:.3f} ms, bare httpx {1e3 * busy[1]:.3f} ms")
    return float(wall[0] - wall[1]), float(busy[0] - busy[1])


def arrays(url: str, count: int) -> tuple[float, float]:
    """What JSON takes over what NumPy files take: in the SDK, and with HTTP."""
    found = answers()

    def reading(name: str) -> Callable[[], object]:
        return lambda: [np.asarray(read(Capture, found[name])) for _ in range(RUN)]

    _, (npy, as_json) = in_turn(-(-count // RUN), reading("npy"), reading("json"))
    print(f"read: .npy {1e6 * npy / RUN:.0f} us, JSON {1e6 * as_json / RUN:.0f} us")
    with Camera(url) as one, Camera(f"{url}/json") as other:
        if not np.array_equal(one.capture(), other.capture()):
            raise RuntimeError("the two forms are not one embedding")
        _, (npy_http, json_http) = in_turn(
            count, lambda: np.asarray(one.capture()), lambda: np.asarray(other.capture())
        )
    print(f"captured: .npy {1e3 * npy_http:.3f} ms, JSON {1e3 * json_http:.3f} ms")
    return float(as_json / npy), float(json_http / npy_http)


def main(
    *,
    count: Annotated[int, typer.Option(min=1, help="Requests of each kind.")] = 1000,
    figures: FiguresOption = None,
) -> None:
    """Measure what the SDK adds to httpx, and what arrays save."""
    with server() as url:
        added, added_busy = overhead(url, count)
        in_sdk, with_http = arrays(url, count)
    values = {
        "sdk_overhead_ms": round(1e3 * added, 3),
        "sdk_overhead_processor_ms": round(1e3 * added_busy, 3),
        "npy_over_json": round(in_sdk, 2),
        "npy_over_json_with_http": round(with_http, 2),
    }
    print(values)
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
