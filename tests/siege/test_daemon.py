"""Daemons of one's own: their circumstances reach them, and nothing else does."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from email.utils import parsedate_to_datetime
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from tests.siege.client import ask
from tests.siege.daemon import (
    Circumstances,
    Launcher,
    NoDiskError,
    fill,
    write_certificate,
)

from veilcam_server.errors import StartError
from veilcam_server.settings import GivenSettings, Settings

pytestmark = pytest.mark.anyio


class Handler(BaseHTTPRequestHandler):
    """Its answers carry the clock in their ``Date``."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        sys.stderr.write("asked\n")
        sys.stderr.flush()


def serve(settings: Settings, on_listening: Callable[[str], None]) -> None:
    if settings.panel == "refuses":
        raise StartError("it refuses")
    if settings.panel == "ends":
        return
    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        on_listening(f"http://127.0.0.1:{server.server_port}")
        server.serve_forever()


@pytest.fixture
def launcher(tmp_path: Path) -> Launcher:
    return Launcher(f"{__name__}:serve", tmp_path)


def settings(tmp_path: Path, panel: str = "ST7735R") -> Settings:
    (tmp_path / "disk").mkdir(exist_ok=True)
    return GivenSettings(
        bundle=tmp_path / "bundle.veilcam",
        device="simulated",
        panel=panel,
        state_dir=tmp_path / "disk" / "state",
    )


@pytest.mark.slow
async def test_it_serves_logs_and_is_killed(launcher: Launcher, tmp_path: Path) -> None:
    with launcher.running(settings(tmp_path), Circumstances()) as daemon:
        assert (await ask(daemon.address, "GET", "/")).status == 200
        assert daemon.logged() == len("asked\n")
        assert daemon.resident() > 1
        assert daemon.alive
        daemon.kill()
        assert not daemon.alive


@pytest.mark.parametrize(
    ("panel", "reason"), [("refuses", "it refuses"), ("ends", "ended without a word")]
)
def test_what_does_not_start_says_why(
    launcher: Launcher, tmp_path: Path, panel: str, reason: str
) -> None:
    with (
        pytest.raises(StartError, match=reason),
        launcher.running(settings(tmp_path, panel), Circumstances()),
    ):
        pass


@pytest.mark.slow
async def test_its_clock_jumps(launcher: Launcher, tmp_path: Path) -> None:
    clock = launcher.clock()
    with launcher.running(settings(tmp_path), Circumstances(clock=clock)) as daemon:
        for offset in (0.0, -400 * 86_400.0):
            clock.value = offset
            date = (await ask(daemon.address, "GET", "/")).headers["date"]
            assert parsedate_to_datetime(date).timestamp() == pytest.approx(
                time.time() + offset, abs=60
            )


@pytest.mark.slow
def test_nothing_that_looks_at_a_clock_is_imported_before_it_is_set() -> None:
    code = (
        "import sys, tests.siege.daemon; "
        "print([name for name in sys.modules if name.startswith('veilcam_server')])"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    for room in ("security", "camera", "service", "bundles", "daemon"):
        assert f"veilcam_server.{room}" not in loaded.stdout


def test_no_environment_reaches_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VEILCAM_PORT", "1234")
    monkeypatch.setenv("VEILCAM_STATE_DIR", "/elsewhere")
    made = settings(tmp_path)
    assert made.port != 1234
    assert made.state_dir == tmp_path / "disk" / "state"


def test_its_disk_is_its_own_and_can_be_filled(launcher: Launcher, tmp_path: Path) -> None:
    given = settings(tmp_path)
    given.state_dir.mkdir()
    (given.state_dir / "kept").write_bytes(b"kept")
    try:
        with launcher.running(given, Circumstances(disk=2**20)) as daemon:
            assert (daemon.state / "kept").read_bytes() == b"kept"
            fill(daemon.state.parent)
            with pytest.raises(OSError, match="No space left"):
                (daemon.state / "more").write_bytes(bytes(4096))
            (daemon.state.parent / "ballast").unlink()
            (daemon.state / "more").write_bytes(bytes(4096))
            assert not (given.state_dir / "more").exists()
    except NoDiskError as error:
        pytest.skip(str(error))


def test_a_folder_is_new_for_every_row(launcher: Launcher) -> None:
    (launcher.fresh("row") / "left").touch()
    assert not list(launcher.fresh("row").iterdir())


def test_a_certificate_and_its_key(tmp_path: Path) -> None:
    certificate, key = write_certificate(tmp_path)
    assert b"BEGIN CERTIFICATE" in certificate.read_bytes()
    assert b"PRIVATE KEY" in key.read_bytes()
