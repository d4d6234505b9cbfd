"""What must hold for veilcamd as a unit; a check is a line of JSON on the second serial port."""

from __future__ import annotations

import http.client
import json
import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from veilcam_client import Camera, VeilcamError
from veilcam_client.models import EveryCaptures

from . import network, panel, probe
from .prepare import SHARED

SOCKET = Path("/run/veilcam/api.sock")
URLS = (f"unix://{SOCKET}", "http://127.0.0.1:8787")
STATE = Path("/var/lib/veilcam")
HERE = Path(__file__).resolve().parent
PYTHON = "/usr/bin/python3"
"""It finds the packages of the release where its environment says, which the unit is told, too."""
DROP_IN = Path("/run/systemd/system/veilcamd.service.d/other.conf")
PATIENCE = 900.0
"""Of waits for the daemon; an emulated processor is slow [s]."""


def run(*command: str, check: bool = True) -> str:
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if check and done.returncode != 0:
        raise AssertionError(f"{' '.join(command)}: {done.stderr.strip() or done.stdout.strip()}")
    return done.stdout.strip()


def unit(name: str) -> str:
    return run("systemctl", "show", "--value", "-p", name, "veilcamd.service")


def journal() -> str:
    return run("journalctl", "-u", "veilcamd.service", "-o", "cat", "--no-pager")


def wait_until(reached: Callable[[], bool], what: str, seconds: float = PATIENCE) -> float:
    begin = time.monotonic()
    while not reached():
        if time.monotonic() - begin > seconds:
            raise AssertionError(f"not within {seconds:.0f} s: {what}")
        time.sleep(0.5)
    return time.monotonic() - begin


class Checks:
    def __init__(self, report: Callable[[str, bool, str], None]) -> None:
        self._report = report
        self._token = ""
        self._bus_while_serving: list[panel.Byte] = []
        self._bus_after_stop: list[panel.Byte] = []

    def run(self) -> None:
        for check in (
            self.ready_at_boot,
            self.answers_on_both_sockets,
            self.tokens_are_wanted,
            self.the_socket_file_is_its_group_s,
            self.classifies_in_the_sandbox,
            self.has_a_network_of_its_own,
            self.watchdog_kills_and_restarts,
            self.stop_is_clean,
            self.a_connection_starts_it,
            self.stop_ends_opaque,
            self.sandbox_holds,
            self.bytes_of_py_spidev,
            self.serves_others_over_tls,
            self.removing_leaves_the_state,
        ):
            name = check.__name__.replace("_", " ")
            print(f"check: {name} ...", flush=True)  # noqa: T201
            try:
                self._report(name, True, check() or "")
            except Exception as error:  # whatever it is, the others are made
                self._report(name, False, f"{type(error).__name__}: {error}")
                print(journal()[-1500:], flush=True)  # noqa: T201

    def ready_at_boot(self) -> str:
        """Type=notify: active means that requests are answered."""
        wait_until(lambda: unit("ActiveState") in ("active", "failed"), "the unit is active")
        assert unit("ActiveState") == "active", journal()[-600:]
        assert (unit("Type"), unit("NRestarts")) == ("notify", "0")
        with Camera(URLS[0], max_retries=0) as camera:
            self._refused(camera)
        version = run("systemctl", "--version").splitlines()[0]
        begin, end = (f"{each}TimestampMonotonic" for each in ("InactiveExit", "ActiveEnter"))
        took = int(unit(end)) - int(unit(begin))
        return f"{version}; {took / 1e6:.0f} s to start"

    def answers_on_both_sockets(self) -> str:
        self._token = run(
            *("runuser", "-u", "veilcam", "--", "/usr/bin/veilcamd", "token"),
            *("create", "--label", "checks", "--scope", "read:status", "--scope", "classify"),
            *("--state-dir", str(STATE)),
        ).splitlines()[-1]
        for url in URLS:
            with self._camera(url) as camera:
                status = camera.status()
            assert status.state == "ready", (url, status)
            # Of /etc/veilcam/veilcam.env: JSON comes through whole.
            assert status.rotation.policy == EveryCaptures(captures=1000), status
        return "unix and loopback"

    def tokens_are_wanted(self) -> str:
        for url in URLS:
            with Camera(url, max_retries=0) as camera:
                self._refused(camera)
        return ""

    def the_socket_file_is_its_group_s(self) -> str:
        """Who is not in the group veilcam cannot connect."""
        status = SOCKET.stat()
        assert status.st_mode & 0o777 == 0o660
        script = f"import socket; socket.socket(socket.AF_UNIX).connect({str(SOCKET)!r})"
        run("runuser", "-u", "veilcam", "--", PYTHON, "-c", script)
        refused = ["runuser", "-u", "nobody", "--", PYTHON, "-c", script]
        denied = subprocess.run(refused, check=False, capture_output=True, text=True)
        assert "PermissionError" in denied.stderr
        return "nobody is refused"

    def classifies_in_the_sandbox(self) -> str:
        """The whole path, with a simulated panel and sensor."""
        with self._camera(URLS[0]) as camera:
            return f"label {camera.classify().label}"

    def has_a_network_of_its_own(self) -> str:
        """PrivateNetwork=, as the kernel has it."""
        process = unit("MainPID")
        own, ours = (os.readlink(f"/proc/{one}/ns/net") for one in (process, "1"))
        assert own != ours
        devices = Path(f"/proc/{process}/net/dev").read_text().splitlines()[2:]
        assert [line.split(":")[0].strip() for line in devices] == ["lo"]
        status = Path(f"/proc/{process}/status").read_text()
        for line in ("CapEff:\t0000000000000000", "CapBnd:\t0000000000000000", "NoNewPrivs:\t1"):
            assert line in status, line
        assert "Seccomp:\t2" in status
        control = Path("/sys/fs/cgroup/system.slice/veilcamd.service")
        assert (control / "memory.swap.max").read_text().strip() == "0"
        return "no capability, seccomp, no swap"

    def watchdog_kills_and_restarts(self) -> str:
        """A daemon that stands still is killed and started again."""
        before, restarts = unit("MainPID"), unit("NRestarts")
        os.kill(int(before), signal.SIGSTOP)
        took = wait_until(lambda: unit("NRestarts") != restarts, "the watchdog bites", 300)
        assert "Watchdog timeout" in journal(), journal()[-600:]
        wait_until(lambda: unit("ActiveState") == "active", "it is active again")
        assert unit("MainPID") not in (before, "0")
        with self._camera(URLS[0]) as camera:
            assert camera.status().state == "ready"
        return f"killed {took:.0f} s after it stood still; ready again"

    def stop_is_clean(self) -> str:
        """SIGTERM ends with the state stopping, and without a complaint."""
        run("systemctl", "stop", "veilcamd.service")
        assert (unit("Result"), unit("ExecMainStatus")) == ("success", "0"), journal()[-600:]
        assert '"state": "stopping"' in journal()
        assert SOCKET.exists()
        return ""

    def sandbox_holds(self) -> str:
        """Everything that the daemon has no use for is refused, and possible outside."""
        self._open_everything()
        with socket.create_server(("127.0.0.1", probe.PORT)):
            Path("/srv/state").mkdir()
            shutil.chown("/srv/state", "veilcam")
            who = ("runuser", "-u", "veilcam", "--")
            outside = json.loads(run(*who, PYTHON, "-m", "guest.probe", "attempts", "/srv/state"))
            with self._instead("Type=oneshot", "Restart=no", "WatchdogSec=0",
                # What runs after the probe has the same output, and must not empty it.
                "StandardOutput=append:/run/panel/probe", "StandardError=journal",
                program=f"{PYTHON} -m guest.probe attempts,needs {STATE}"):  # fmt: skip
                run("systemctl", "start", "veilcamd.service")
        inside = json.loads(Path("/run/panel/probe").read_text())
        impossible = [name for name, done in outside["attempts"].items() if done is not True]
        assert not impossible, f"not even outside: {impossible}, {outside['attempts']}"
        possible = [name for name, done in inside["attempts"].items() if done is True]
        assert not possible, f"possible: {possible}"
        missing = {name: why for name, why in inside["needs"].items() if why is not True}
        assert not missing, f"missing: {missing}"
        return f"{len(inside['attempts'])} attempts refused, {len(inside['needs'])} needs met"

    def a_connection_starts_it(self) -> str:
        """Socket activation. What is started also drives a bus, in the sandbox, until it stops."""
        with self._instead(program=f"{PYTHON} -m guest.panel serve"):
            assert unit("ActiveState") == "inactive"
            with socket.socket(socket.AF_UNIX) as client:
                client.settimeout(PATIENCE)
                client.connect(str(SOCKET))
                client.sendall(
                    b"GET /v1/status HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
                )
                answer = http.client.HTTPResponse(client)
                answer.begin()
            assert answer.status == http.client.UNAUTHORIZED, answer.status
            assert unit("ActiveState") == "active"
            self._bus_while_serving = self._bus()
            run("systemctl", "stop", "veilcamd.service")
            assert unit("Result") == "success", journal()[-600:]
            self._bus_after_stop = self._bus()
        return "its first request was answered"

    def stop_ends_opaque(self) -> str:
        """The last thing that left over the bus is an opaque frame, and the display is on."""
        assert panel.shown(self._bus_while_serving).framebuffer().any(), "no mask came out"
        after = panel.shown(self._bus_after_stop)
        assert not after.framebuffer().any()
        assert not after.transparent
        return f"{len(self._bus_after_stop)} bytes over py-spidev, in the sandbox"

    def bytes_of_py_spidev(self) -> str:
        """What came out of the bus is what the emulator took, byte for byte with D/C."""
        return run(PYTHON, "-m", "guest.panel", "write")

    def serves_others_over_tls(self) -> str:
        """As deploy/README.md says, whatever the daemon itself may do in a network."""
        network.open_to_others((HERE.parent / "README.md").read_text())
        url = f"https://{network.ADDRESS}:8787"
        file = network.CERTIFICATE
        with Camera(url, token=self._token, ca_file=file, read_timeout=PATIENCE) as camera:
            label = camera.classify().label
        with Camera(url, max_retries=0, ca_file=file) as camera:
            self._refused(camera)
        return f"label {label} with a token, none without"

    def removing_leaves_the_state(self) -> str:
        """Nothing is left but state and settings; with --purge these go, too."""
        run("dpkg", "--remove", "veilcam")
        edited = {network.UNITS / f"veilcamd.{kind}.d" for kind in ("service", "socket")}
        # Whether it was enabled is a setting, for when it is installed again.
        wanted = (
            "multi-user.target.wants/veilcamd.service",
            "sockets.target.wants/veilcamd.socket",
        )
        enabled = {network.UNITS / each for each in wanted}
        kept = {STATE, Path("/etc/veilcam"), *edited, *enabled}
        assert self._left() == kept, self._left()
        assert (STATE / "device-key.json").exists()
        assert not SOCKET.exists()
        run("dpkg", "--purge", "veilcam")
        assert not self._left(), self._left()
        return "and with --purge nothing"

    @staticmethod
    def _left() -> set[Path]:
        """Files and folders by our name; the checks' own are called veilcam-SOMETHING."""
        names = run(
            *("find", "/etc", "/opt", "/run/veilcam", "/usr", "/var"),
            # What dpkg and systemd themselves remember.
            *("-path", "/var/lib/dpkg", "-prune", "-o", "-path", "/var/lib/systemd", "-prune"),
            *("-o", "-name", "*veilcam*", "-not", "-name", "veilcam-*", "-prune", "-print"),
            check=False,  # one of the folders may be gone
        )
        return {Path(name) for name in names.splitlines()}

    @staticmethod
    def _bus() -> list[panel.Byte]:
        return list(panel.came_out((SHARED / "bus").read_bytes()))

    def _camera(self, url: str) -> Camera:
        return Camera(url, token=self._token, read_timeout=PATIENCE)

    @staticmethod
    def _refused(camera: Camera) -> None:
        status = None
        try:
            camera.status()
        except VeilcamError as error:
            status = error.status
        assert status == http.client.UNAUTHORIZED, status

    @staticmethod
    def _open_everything() -> None:
        for folder in probe.OPEN_FOLDERS:
            folder.mkdir()
            folder.chmod(0o777)
        for file in probe.OTHERS:
            file.write_text("x")
            file.chmod(0o666)
        for device in probe.OPEN_DEVICES:
            device.chmod(0o666)

    @staticmethod
    @contextmanager
    def _instead(*settings: str, program: str) -> Iterator[None]:
        run("systemctl", "stop", "veilcamd.service")
        DROP_IN.parent.mkdir(parents=True, exist_ok=True)
        paths = f"Environment=PYTHONPATH={os.environ['PYTHONPATH']}"
        lines = [paths, f"WorkingDirectory={HERE.parent}", "ExecStart=", f"ExecStart={program}"]
        lines += settings
        DROP_IN.write_text("\n".join(["[Service]", *lines]) + "\n")
        run("systemctl", "daemon-reload")
        try:
            yield
        finally:
            DROP_IN.unlink()
            run("systemctl", "stop", "veilcamd.service")
            run("systemctl", "daemon-reload")


def main() -> None:
    with Path("/dev/ttyS1").open("w") as results:

        def report(name: str, passed: bool, detail: str) -> None:
            print(f"check: {name}: {'passed' if passed else 'FAILED'} {detail}", flush=True)  # noqa: T201
            line = {"name": name, "passed": passed, "detail": detail[:400]}
            results.write(json.dumps(line) + "\n")
            results.flush()

        Checks(report).run()


if __name__ == "__main__":
    main()
