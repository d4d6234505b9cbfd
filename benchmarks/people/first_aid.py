"""Faults of the SDK that people met: answers of another process, and streams that knock for ever.

python -m benchmarks.people.first_aid fork --figures benchmarks/results/first-aid.json
python -m benchmarks.people.first_aid storm --figures benchmarks/results/first-aid.json
"""

from __future__ import annotations

import os
import socketserver
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, get_args

import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.rig import prompt_daemon, work_folder

from veilcam_client import Camera
from veilcam_client.wire.tokens import Scope
from veilcam_server.security.tokens import TokenStore

CHILDREN, CALLS = 4, 3
"""Processes that share a camera at a time, and calls of each."""
HEALTHY = 35.0
"""A stream is open for so long before its daemon goes: a healthy one [s]."""
WATCHED = 60.0
"""Connections are counted for so long [s]."""

app = typer.Typer(help=__doc__)


@app.command()
def fork(
    turns: Annotated[int, typer.Option(min=1, help="Cameras that are forked.")] = 12,
    figures: FiguresOption = None,
) -> None:
    """Count answers of another process: a camera is used, and then by four forked processes."""
    with work_folder() as folder:
        made = TokenStore(folder / "state").create("all", get_args(Scope), None)
        with prompt_daemon(folder, "--auth", "tokens") as url:
            foreign = sum(foreign_answers(url, made.secret, turn) for turn in range(turns))
    print(
        f"{foreign} of {turns * CHILDREN * CALLS} calls failed or were answered to another process"
    )
    record(figures, {"fork_foreign_answers": foreign})


def foreign_answers(url: str, token: str, turn: int) -> int:
    """Return how many calls of forked processes have another answer than their own."""
    with Camera(url, token=token) as camera:
        camera.status()
        ready, go = os.pipe()
        children = []
        for number in range(CHILDREN):
            child = os.fork()
            if child == 0:
                os.close(go)
                os.read(ready, 1)  # all begin when the parent closes its end
                os._exit(_foreign(camera, f"turn {turn} process {number}"))
            children.append(child)
        os.close(ready)
        os.close(go)
        return sum(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children)


def _foreign(camera: Camera, label: str) -> int:
    foreign = 0
    for _ in range(CALLS):
        try:
            foreign += camera.tokens.create(label, ["read:status"]).label != label
        except Exception:  # what came was for another process, too
            foreign += 1
    return foreign


@app.command()
def storm(figures: FiguresOption = None) -> None:
    """Count connections of a stream in the first minute after its daemon is gone."""
    with gone_daemon() as (url, knocks):

        def read() -> None:
            for _ in stream:
                pass

        with Camera(url) as camera, camera.events() as stream:
            reading = threading.Thread(target=read)
            reading.start()
            time.sleep(HEALTHY + WATCHED)
            stream.close()
            reading.join()
    print(f"{len(knocks)} connections in {WATCHED:.0f} s")
    record(figures, {"storm_connections_60s": len(knocks)})


@contextmanager
def gone_daemon() -> Iterator[tuple[str, list[float]]]:
    """Yield a daemon that streams for a while and then ends each connection, and these."""
    knocks: list[float] = []
    until = time.monotonic() + HEALTHY

    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            if time.monotonic() > until:
                knocks.append(time.monotonic())
                return
            self.wfile.write(b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\n\r\n")
            while time.monotonic() < until:
                self.wfile.write(b": heartbeat\n\n")
                time.sleep(0.5)

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler) as server:
        serving = threading.Thread(target=server.serve_forever, args=(0.05,))
        serving.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}", knocks
        finally:
            server.shutdown()
            serving.join()


if __name__ == "__main__":
    app()
