"""What is told to systemd, and the sockets that it passes."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from veilcam_server.system.systemd import notify, watchdog_period


@pytest.mark.parametrize("abstract", [False, True])
def test_systemd_is_told(abstract: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"veilcam-test-{os.getpid()}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.settimeout(300)
        systemd.bind("\0" + name if abstract else name)
        monkeypatch.setenv("NOTIFY_SOCKET", "@" + name if abstract else name)
        notify("READY=1\nSTATUS=ready")
        assert systemd.recv(100) == b"READY=1\nSTATUS=ready"


def test_notification_without_systemd_is_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    notify("READY=1")
    assert capsys.readouterr().out == ""
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "nobody"))
    notify("READY=1")
    assert "systemd not told" in capsys.readouterr().out


def test_watchdog_is_for_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WATCHDOG_USEC", raising=False)
    monkeypatch.delenv("WATCHDOG_PID", raising=False)
    assert watchdog_period() is None
    monkeypatch.setenv("WATCHDOG_USEC", "30000000")
    assert watchdog_period() == 30.0
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
    assert watchdog_period() == 30.0
    monkeypatch.setenv("WATCHDOG_PID", "1")
    assert watchdog_period() is None


# Descriptors are passed as systemd does it: from 3 on, and the process that takes them is named.
TAKE = """
import os, sys
from veilcam_server.errors import StartError
from veilcam_server.system.systemd import take_sockets
os.environ["LISTEN_PID"] = sys.argv[1] or str(os.getpid())
try:
    for taken in take_sockets():
        print(taken.family.name, taken.proto, taken.getsockname(), taken.get_inheritable())
except StartError as error:
    print(error)
assert "LISTEN_FDS" not in os.environ
print(len(take_sockets()), "left")
"""


def taken_by_a_process(*passed: socket.socket, process: str = "") -> list[str]:
    command = [sys.executable, "-c", TAKE, process]
    # Duplicates far up, then down to 3: a socket may itself have one of those numbers here.
    high = [os.dup(one.fileno()) for one in passed]
    shell = " ".join(f"{3 + index}<&{number}" for index, number in enumerate(high))
    environment = {
        **os.environ,
        "LISTEN_FDS": str(len(passed)),
        "LISTEN_FDNAMES": ":".join(f"name{index}" for index in range(len(passed))),
    }
    try:
        done = subprocess.run(
            ["bash", "-c", f'exec "$@" {shell}', "take", *command],
            pass_fds=high,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
    finally:
        for number in high:
            os.close(number)
    return done.stdout.splitlines()


@pytest.mark.slow
def test_sockets_of_systemd(tmp_path: Path) -> None:
    path = tmp_path / "api.sock"
    with (
        socket.create_server(("127.0.0.1", 0)) as tcp,
        socket.socket(socket.AF_UNIX) as unix,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as datagrams,
    ):
        unix.bind(str(path))
        unix.listen()
        assert taken_by_a_process(tcp, unix) == [
            # asyncio turns Nagle's algorithm off only where the protocol is known.
            f"AF_INET {socket.IPPROTO_TCP} {tcp.getsockname()} False",
            f"AF_UNIX 0 {path} False",
            "0 left",
        ]
        assert taken_by_a_process(tcp, process="1") == ["0 left"]
        refused = taken_by_a_process(tcp, datagrams)
        assert refused[0].startswith("systemd passed 'name1', which is no listening socket: use")
