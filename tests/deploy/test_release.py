"""Which release runs: the one that was installed last, or the last one that was ready."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

SCRIPT = Path(__file__).resolve().parents[2] / "deploy" / "debian" / "release.sh"
TRIES = 3


@dataclass
class Device:
    root: Path

    def __post_init__(self) -> None:
        text = SCRIPT.read_text()
        for place in ("/usr/lib/veilcam", "/var/lib/veilcam-release"):
            (self.root / place.lstrip("/")).parent.mkdir(parents=True, exist_ok=True)
            text = text.replace(f"={place}", f"={self.root}{place}")
        self.script, self.state = self.root / "release", self.root / "var/lib/veilcam-release"
        self.script.write_text(text)

    def run(self, what: str) -> str:
        command = ["sh", str(self.script), what]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout

    def install(self, name: str, content: str = "program") -> None:
        unpacked = self.root / "usr/lib/veilcam/unpacked"
        unpacked.mkdir(parents=True, exist_ok=True)
        for file, text in (("RELEASE", f"{name}\n"), ("code", content)):
            new = unpacked / f"{file}.dpkg-new"
            new.write_text(text)
            new.replace(unpacked / file)
        self.run("install")

    def start(self, *, ready: bool) -> str:
        """As systemd does; return the release that was started."""
        self.run("start")
        name = self.current
        if ready:
            self.run("ready")
        return name

    @property
    def current(self) -> str:
        return (self.state / "current").readlink().name

    @property
    def kept(self) -> set[str]:
        return {path.name for path in (self.root / "usr/lib/veilcam/releases").iterdir()}


@pytest.fixture
def device(tmp_path: Path) -> Device:
    made = Device(tmp_path)
    made.install("1")
    made.start(ready=True)
    return made


def test_a_release_that_does_not_start_gives_way_to_the_one_before(device: Device) -> None:
    device.install("2", "broken")
    assert device.kept == {"1", "2"}
    assert [device.start(ready=False) for _ in range(TRIES)] == ["2"] * TRIES
    assert "did not start 3 times: back to" in device.run("start")
    assert device.current == "1"
    # It stays, however often it fails itself: nothing else is known to be better.
    assert {device.start(ready=False) for _ in range(10)} == {"1"}
    code = device.root / "usr/lib/veilcam/releases/1/code"
    assert code.read_text() == "program"


def test_a_release_that_starts_at_last_stays(device: Device) -> None:
    device.install("2")
    assert [device.start(ready=False) for _ in range(TRIES - 1)] == ["2"] * (TRIES - 1)
    assert device.start(ready=True) == "2"
    assert device.kept == {"2"}
    assert {device.start(ready=False) for _ in range(2 * TRIES)} == {"2"}


def test_the_first_release_is_tried_for_ever(tmp_path: Path) -> None:
    device = Device(tmp_path)
    device.install("1")
    assert {device.start(ready=False) for _ in range(3 * TRIES)} == {"1"}


def test_what_was_installed_again_has_all_tries_again(device: Device) -> None:
    device.install("2", "broken")
    for _ in range(TRIES + 1):
        device.start(ready=False)
    device.install("2", "mended")
    assert device.start(ready=True) == "2"
    assert (device.root / "usr/lib/veilcam/releases/2/code").read_text() == "mended"


def test_installing_leaves_alone_what_runs(device: Device) -> None:
    running = device.root / "usr/lib/veilcam/releases/1/code"
    before = running.stat().st_ino
    device.install("2", "second")
    assert (running.read_text(), running.stat().st_ino) == ("program", before)


@pytest.mark.parametrize("left", [b"", b"tr", b"\0\0\0\0", b"\n" * 100])
def test_a_count_that_a_power_cut_left_keeps_nothing_from_starting(
    device: Device, left: bytes
) -> None:
    device.install("2")
    (device.state / "tries").write_bytes(left)
    assert device.start(ready=True) in {"1", "2"}
    assert device.start(ready=False) in {"1", "2"}


def test_removing_leaves_nothing(device: Device) -> None:
    device.install("2")
    device.run("remove")
    assert not device.state.exists()
    assert not (device.root / "usr/lib/veilcam/releases").exists()


@pytest.mark.slow
@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    steps=st.lists(
        st.one_of(
            st.tuples(st.just("install"), st.integers(1, 4)),
            st.tuples(st.just("start"), st.booleans()),
        ),
        max_size=15,
    )
)
def test_whatever_happens_there_is_a_way_back(
    steps: list[tuple[str, int]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    device = Device(tmp_path_factory.mktemp("device"))
    device.install("0")
    good: str | None = None
    failed = 0
    for what, value in steps:
        if what == "install":
            device.install(str(value))
            failed = 0
        else:
            started = device.start(ready=bool(value))
            good = started if value else good
            failed = 0 if value else failed + 1
        # What was ready last is whole, nothing else is kept but what is current,
        assert device.kept == {device.current, *(() if good is None else (good,))}
        # and what fails more often than it is tried is what was ready.
        if good is not None and failed > TRIES:
            assert device.current == good
