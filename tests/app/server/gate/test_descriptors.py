"""Files that are left for what is no connection."""

from __future__ import annotations

import resource
import socket
import subprocess
import sys
import textwrap

import pytest

from veilcam_server.gate.descriptors import RESERVE, WAITING, Room, room_for


class Limits:
    def __init__(self, soft: int, hard: int) -> None:
        self.soft, self.hard = soft, hard

    def get(self, _: int) -> tuple[int, int]:
        return self.soft, self.hard

    def set(self, _: int, limits: tuple[int, int]) -> None:
        self.soft, self.hard = limits


@pytest.mark.parametrize(
    ("soft", "hard", "room", "raised"),
    [
        (8192, 8192, Room(256, WAITING), 8192),
        (1024, 524288, Room(256, WAITING), 256 + WAITING + RESERVE),
        (1024, resource.RLIM_INFINITY, Room(256, WAITING), 256 + WAITING + RESERVE),
        (resource.RLIM_INFINITY, resource.RLIM_INFINITY, Room(256, WAITING), -1),
        (1024, 1024, Room(256, 1024 - RESERVE - 256), 1024),
        (256, 256, Room(96, 32), 256),
        (100, 100, Room(37, 13), 100),
    ],
)
def test_room_follows_the_limits(
    monkeypatch: pytest.MonkeyPatch, soft: int, hard: int, room: Room, raised: int
) -> None:
    limits = Limits(soft, hard)
    monkeypatch.setattr(resource, "getrlimit", limits.get)
    monkeypatch.setattr(resource, "setrlimit", limits.set)
    assert room_for(256) == room
    assert (limits.soft, limits.hard) == (raised, hard)


def test_room_that_is_less_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(resource, "getrlimit", Limits(256, 256).get)
    monkeypatch.setattr(resource, "setrlimit", Limits(256, 256).set)
    room_for(96)
    assert "few files" not in capsys.readouterr().out
    room_for(97)
    assert "few files may be open" in capsys.readouterr().out


PROGRAM = """
    import resource, signal, socket
    import uvicorn
    from veilcam_server.gate.connections import Connections
    from veilcam_server.gate.protocol import Deadlines
    from veilcam_server.gate.server import Gate, GateServer

    async def app(scope, receive, send):
        await receive()
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b"ok"})

    resource.setrlimit(resource.RLIMIT_NOFILE, (40, 40))
    listener = socket.create_server(("127.0.0.1", 0))
    print(listener.getsockname()[1], flush=True)
    config = uvicorn.Config(app, http="h11", ws="none", lifespan="off", log_config=None)
    # uvicorn raises it again once all has ended.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    # More than there are files: what was reserved is used up by somebody else.
    connections = Connections(1000)
    GateServer(config, Gate(connections, Deadlines(600, 600), 1000)).run([listener])
    print(connections.failures, connections.dropped["evicted"], flush=True)
"""


@pytest.mark.slow
def test_process_without_files_serves() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(PROGRAM)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        address = ("127.0.0.1", int(process.stdout.readline()))
        crowd = [socket.create_connection(address) for _ in range(60)]
        for one in crowd:
            one.sendall(b"GET")
        with socket.create_connection(address, timeout=60) as client:
            client.sendall(b"GET / HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n")
            assert client.recv(100).startswith(b"HTTP/1.1 200")
        process.terminate()
        said = process.stdout.read()
        for one in crowd:
            one.close()
    lines = said.splitlines()
    assert sum("connection not accepted" in line for line in lines) == 1
    failures, evicted = map(int, lines[-1].split())
    assert failures >= 1
    assert evicted >= 20
