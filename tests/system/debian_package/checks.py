"""What must hold for the package, in the order in which it is tried."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from veilcam_client import Camera
from veilcam_client.wire.status import Status

from . import reading
from .packages import variant
from .root import Root
from .supervisor import Supervisor

STATE = "var/lib/veilcam"
ENV = "etc/veilcam/veilcam.env"
RECORDING = "etc/veilcam/recording.jsonl"
COMPILERS = ("gcc", "cc", "g++", "pip", "pip3")
MOST_MB, MOST_S = 200.0, 60.0
"""On the card beside apt's packages; and until the old release serves again."""
READ_TIMEOUT = 300.0  # [s]


@dataclass(frozen=True)
class Result:
    name: str
    passed: bool
    detail: str


@dataclass
class Checks:
    """All of them, on one root; ``patience`` is how many times longer the machine takes."""

    root: Root
    package: Path
    recording: Path
    measured: Path
    folder: Path
    patience: float = 1.0
    figures: dict[str, float] = field(default_factory=dict)
    accuracies: dict[str, float] = field(default_factory=dict)
    _before: set[str] = field(default_factory=set)
    _token: str = ""
    _supervisor: Supervisor | None = None

    def run(self, report: Callable[[Result], None]) -> bool:
        try:
            for check in (
                self.installs_from_its_file_alone,
                self.commands_run,
                self.reads_what_this_machine_reads,
                self.daemon_is_ready,
                self.a_second_install_changes_nothing,
                self.state_is_kept_over_three_upgrades,
                self.a_release_that_fails_goes_back_by_itself,
                self.the_doctor_says_so,
                self.removing_leaves_settings_and_state,
                self.purging_leaves_nothing,
            ):
                name = check.__name__.replace("_", " ")
                try:
                    report(Result(name, True, check()))
                except Exception as error:
                    report(Result(name, False, f"{type(error).__name__}: {error}"))
                    return False
            return True
        finally:
            if self._supervisor is not None:
                self._supervisor.__exit__()

    def installs_from_its_file_alone(self) -> str:
        """No network, no compiler, no pip."""
        self._before, room = self.root.files(), self.root.room()
        self.root.install(self.package)
        for name in COMPILERS:  # neither before
            found = self.root.run("sh", "-c", f"command -v {name}", check=False)
            assert not found.strip(), f"{name} is there"
        taken = self.root.room() - room
        self.figures["device_install_mb"] = taken
        assert taken <= MOST_MB, f"{taken:.0f} MB"
        return f"{taken:.0f} MB on the disk"

    def commands_run(self) -> str:
        said = [self.root.run(name, "--version").strip() for name in ("veilcam", "veilcamd")]
        assert "--broker" in self.root.run("veilcam-mqtt", "--help")
        numpy = self.root.run("python3", "-c", "import numpy; print(numpy.__version__)").strip()
        return f"{', '.join(said)}; NumPy {numpy}"

    def reads_what_this_machine_reads(self) -> str:
        """Digits behind stored and fresh masks: no label depends on NumPy or processor."""
        here = reading.read(self.measured)
        program = self.root.path / "srv/reading.py"
        program.write_bytes(Path(reading.__file__).read_bytes())
        digits = self.root.path / "srv/measured.npz"
        digits.write_bytes(self.measured.read_bytes())
        release = "/usr/lib/veilcam/unpacked"
        minor = self.root.run("python3", "-c", "import sys; print(*sys.version_info[:2], sep='')")
        paths = f"PYTHONPATH={release}/lib:{release}/py{minor.strip()}"
        said = self.root.run("env", paths, "python3", "-B", "/srv/reading.py", "/srv/measured.npz")
        for file in (program, digits):
            file.unlink()
        there = json.loads(said.splitlines()[-1])
        same = (*reading.BUNDLES, "labels")
        assert [there[name] for name in same] == [here[name] for name in same], (there, here)
        self.accuracies |= {name: there[name] for name in reading.BUNDLES}
        return f"accuracy {self.accuracies}, NumPy {there['numpy']} and {here['numpy']}"

    def daemon_is_ready(self) -> str:
        (self.root.path / RECORDING).write_bytes(self.recording.read_bytes())
        env = self.root.path / ENV
        text = env.read_text().replace("VEILCAM_BUNDLE=", "#VEILCAM_BUNDLE=")
        env.write_text(text + f"VEILCAM_REPLAY=/{RECORDING}\n")
        self._token = self.root.run(
            *("veilcamd", "token", "create", "--label", "checks", "--scope", "read:status"),
            *("--scope", "classify", "--state-dir", f"/{STATE}"),
            user="veilcam",
        ).splitlines()[-1]
        self._supervisor = Supervisor(self.root, patience=self.patience)
        begin = time.monotonic()
        self._supervisor.__enter__()
        self._wait_ready()
        took = time.monotonic() - begin
        with self._camera() as camera:
            label = camera.classify().label
        return f"after {took:.1f} s; label {label}"

    def a_second_install_changes_nothing(self) -> str:
        """Over a running daemon, which goes on."""
        before = self._release()
        with self._camera() as camera:
            self.root.install(self.package)
            camera.status()
        assert self._release() == before
        self._restart()
        return before

    def state_is_kept_over_three_upgrades(self) -> str:
        """Its token is valid behind each, and its settings are as they were."""
        settings = (self.root.path / ENV).read_text()
        for number in range(1, 4):
            name = f"0.1.0+{number}"
            package = variant(self.package, name, self.folder)
            with self._camera() as camera:
                self.root.install(package)
                camera.status()  # what runs still does
            package.unlink()
            self._restart()
            assert self._release() == f"{name}-variant"
            self._status()
            assert len(self._kept()) == 1, self._kept()
        assert (self.root.path / ENV).read_text() == settings
        return self._release()

    def a_release_that_fails_goes_back_by_itself(self) -> str:
        """It is tried three times; who asks meanwhile is answered by the release before."""
        assert self._supervisor is not None
        before, started = self._release(), len(self._supervisor.starts)
        package = variant(self.package, "0.1.0+4", self.folder, broken=True)
        self.root.install(package)
        answers: list[str] = []
        asker = threading.Thread(target=lambda: answers.append(self._status().state))
        begin, spent = time.monotonic(), self._supervisor.spent()
        self._supervisor.restart()
        asker.start()
        self._wait_ready()
        took, spent = time.monotonic() - begin, self._supervisor.spent() - spent
        asker.join(READ_TIMEOUT * self.patience)
        self.figures["failed_upgrade_back_s"] = took
        starts = self._supervisor.starts[started:]
        assert starts == ["0.1.0+4-variant"] * 3 + [before], starts
        assert answers == ["replay"], "who asked while it failed was not answered"
        # Of a machine that does nothing else: others here take from the clock what they like.
        assert spent <= MOST_S * self.patience, f"{spent:.0f} s"
        self._restart()
        assert self._release() == before
        return f"{before} serves again after {took:.0f} s, {spent:.0f} s without other programs"

    def the_doctor_says_so(self) -> str:
        said = self.root.run("veilcamd", "doctor", "--json", check=False)
        assert "0.1.0+4-variant did not start" in said, said
        return ""

    def removing_leaves_settings_and_state(self) -> str:
        assert self._supervisor is not None
        self._supervisor.__exit__()
        self._supervisor = None
        self.root.run("dpkg", "--remove", "veilcam")
        left = self.root.files() - self._before
        others = {one for one in left if not one.startswith(("etc/", "var/lib/systemd"))}
        assert {one for one in others if not one.startswith(STATE)} == set(), others
        assert f"{STATE}/tokens.json" in left
        return f"{len(left)} files"

    def purging_leaves_nothing(self) -> str:
        """But for the user and its groups, as is Debian's custom."""
        self.root.run("dpkg", "--purge", "veilcam")
        left = self.root.files() - self._before
        # What the last change of the users' files leaves for the next one.
        custom = {f"etc/{name}" for name in ("group-", "gshadow-", "passwd-", "shadow-")}
        custom |= {"etc/.pwd.lock", "etc/subuid-", "etc/subgid-"}
        assert left <= custom, left - custom
        return ""

    def _camera(self) -> Camera:
        assert self._supervisor is not None
        patience = READ_TIMEOUT * self.patience
        return Camera(
            self._supervisor.url, token=self._token, timeout=patience, read_timeout=patience
        )

    def _status(self) -> Status:
        with self._camera() as camera:
            return camera.status()

    def _restart(self) -> None:
        assert self._supervisor is not None
        self._supervisor.restart()
        self._wait_ready()

    def _wait_ready(self) -> None:
        assert self._supervisor is not None
        self._supervisor.wait_ready(180 * self.patience)

    def _release(self) -> str:
        return (self.root.path / "var/lib/veilcam-release/current").readlink().name

    def _kept(self) -> list[str]:
        return sorted(path.name for path in (self.root.path / "usr/lib/veilcam/releases").iterdir())
