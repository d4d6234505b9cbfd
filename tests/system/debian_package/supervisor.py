"""What systemd does for the unit, as far as starting, readiness and restarting go.

It reads the shipped unit: what runs before, at and after a start, its environment, and the pause
between two starts. It holds the socket, as systemd does, and hears ``READY=1``. It has no sandbox
and no watchdog.
"""

from __future__ import annotations

import os
import re
import resource
import shlex
import signal
import socket
import subprocess
import threading
import time
from collections import defaultdict
from pathlib import Path

from .root import Root

SOCKET = "run/veilcam/api.sock"
NOTIFY = "run/notify"
FIRST_DESCRIPTOR = 3


class Supervisor:
    def __init__(self, root: Root, *, patience: float = 1.0) -> None:
        self._root = root
        unit = (root.path / "usr/lib/systemd/system/veilcamd.service").read_text()
        self._unit: dict[str, list[str]] = defaultdict(list)
        for name, value in re.findall(r"(?m)^(\w+)=(.*)$", unit):
            self._unit[name].append(value)
        self._limit = patience * float(self._unit["TimeoutStartSec"][0])
        self._who = root.identity("veilcam")
        self.starts: list[str] = []
        self.ready_at = threading.Event()
        self._paused = 0.0
        self._stop = threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        (root.path / SOCKET).parent.mkdir(parents=True, exist_ok=True)
        for name in (SOCKET, NOTIFY):
            (root.path / name).unlink(missing_ok=True)
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(root.path / SOCKET))
        self._listener.listen(64)
        self._notified = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._notified.bind(str(root.path / NOTIFY))
        (root.path / NOTIFY).chmod(0o666)
        self._notified.settimeout(0.1)
        self._thread = threading.Thread(target=self._keep)

    def __enter__(self) -> Supervisor:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._end()
        self._thread.join()
        self._listener.close()
        self._notified.close()

    @property
    def url(self) -> str:
        return f"unix://{self._root.path / SOCKET}"

    def restart(self) -> None:
        self.ready_at.clear()
        self._end()

    def wait_ready(self, seconds: float) -> None:
        if not self.ready_at.wait(seconds):
            raise AssertionError(f"not ready in {seconds:.0f} s: {self.log()[-1500:]}")

    def spent(self) -> float:
        """Return the processor time of all starts so far, and of the pauses between them [s]."""
        ended = resource.getrusage(resource.RUSAGE_CHILDREN)
        process, running = self._process, 0.0
        if process is not None and process.poll() is None:
            fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
            running = sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")
        return ended.ru_utime + ended.ru_stime + running + self._paused

    def log(self) -> str:
        return (self._root.path / "run/veilcamd.log").read_text(errors="replace")

    def _keep(self) -> None:
        pause = float(self._unit["RestartSec"][0])
        while not self._stop.is_set():
            asked = self._once()
            if not asked:
                self._stop.wait(pause)
                self._paused += pause

    def _once(self) -> bool:
        self._beside("ExecStartPre")
        current = self._root.path / "var/lib/veilcam-release/current"
        self.starts.append(current.readlink().name)
        with (self._root.path / "run/veilcamd.log").open("ab") as log:
            process = self._process = self._start(log.fileno())
        begin = time.monotonic()
        ready = False
        while process.poll() is None:
            if not ready and self._heard_ready():
                self._beside("ExecStartPost")
                ready = True
                self.ready_at.set()
            if self._stop.is_set():  # since it was started
                process.terminate()
            if not ready and time.monotonic() - begin > self._limit:
                process.kill()
            time.sleep(0.05)
        return process.returncode in (0, -signal.SIGTERM)

    def _start(self, log: int) -> subprocess.Popen[bytes]:
        [command] = self._unit["ExecStart"]
        user, group = self._who
        listener = self._listener.fileno()
        return subprocess.Popen(
            [
                # The process that listens is the one that systemd started.
                *("unshare", "--net", "bash", "-c"),
                f'exec {FIRST_DESCRIPTOR}<&"$0"; export LISTEN_PID=$$; exec "$@"',
                str(listener),
                *("chroot", f"--userspec={user}:{group}", str(self._root.path)),
                *shlex.split(command),
            ],
            env={**self._root.environment, **self._environment()},
            stdout=log,
            stderr=log,
            pass_fds=(listener,),
        )

    def _environment(self) -> dict[str, str]:
        given: dict[str, str] = {}
        for line in self._unit["Environment"]:
            given |= dict(each.split("=", 1) for each in shlex.split(line))
        for name in self._unit["EnvironmentFile"]:
            text = (self._root.path / name.lstrip("-/")).read_text()
            given |= dict(re.findall(r"(?m)^(\w+)=(.*)$", text))
        state = self._unit["StateDirectory"][0]
        told = {"NOTIFY_SOCKET": f"/{NOTIFY}", "LISTEN_FDS": "1", "LISTEN_FDNAMES": "api"}
        return {**given, **told, "STATE_DIRECTORY": f"/var/lib/{state}"}

    def _beside(self, name: str) -> None:
        for line in self._unit[name]:
            # "-" and "+": its failure is none, and it runs as root.
            self._root.run(*shlex.split(line.lstrip("-+")), check=False)

    def _heard_ready(self) -> bool:
        try:
            return b"READY=1" in self._notified.recv(4096)
        except TimeoutError:
            return False

    def _end(self) -> None:
        process = self._process
        if process is not None and process.poll() is None:
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
