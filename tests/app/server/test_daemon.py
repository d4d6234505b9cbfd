"""The daemon as a process: what it refuses, and a whole journey over a real socket."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import httpx
import numpy as np
import pytest
from tests.unit.server.logs import events
from typer.testing import CliRunner

from veilcam_client import AsyncCamera, Camera, VeilcamError
from veilcam_client.cli.main import app as client_cli
from veilcam_client.errors import DeviceError, SealedError
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.models import EveryCaptures, EverySeconds, Watching, WatchOff
from veilcam_client.wire.events import Classified, MaskChanged
from veilcam_server.cli.main import app
from veilcam_server.devices.simulated.scenes import write_scene

if TYPE_CHECKING:
    from veilcam_training.bundle import Bundle

runner = CliRunner()


@contextmanager
def daemon(log: Path, *options: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    command = [sys.executable, "-m", "veilcam_server", "serve", "--simulate", *options]
    with (
        log.open("w") as errors,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True) as process,
    ):
        assert process.stdout is not None
        line = process.stdout.readline()
        try:
            assert line.startswith("veilcamd listening on "), log.read_text()
            yield process, line.split()[-1]
        finally:
            process.kill()


@pytest.fixture
def options(bundle_file: Path, scene_file: Path, tmp_path: Path) -> list[str]:
    return [
        *("--bundle", str(bundle_file), "--scenes", str(scene_file)),
        *("--state-dir", str(tmp_path / "state"), "--settle", "0.01", "--exposure", "0.001"),
        *("--release", "raw", "--raw-budget", "1000", "--rotation-off"),
    ]


@pytest.mark.thorough
def test_requests_that_reach_the_application(options: list[str], tmp_path: Path) -> None:
    """An upgrade, a stranger's word for who asks, and a stream whose head alone is wanted."""
    with (
        daemon(tmp_path / "log", "--port", "0", *options) as (_, url),
        httpx.Client(base_url=url, trust_env=False) as client,
    ):
        upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"}
        foreign = {**upgrade, "Origin": "https://page.example"}
        assert client.get("/v1/status", headers=foreign).json()["code"] == "cross_site"
        assert client.get("/v1/status", headers=upgrade).status_code == 200
        assert client.head("/v1/events").status_code == 200
        assert client.head("/healthz").headers["content-length"] == "3"
        client.post("/v1/captures", headers={"X-Forwarded-For": "192.0.2.1"})
    assert [each["caller"] for each in events(tmp_path / "state", "capture")] == ["127.0.0.1"]


@pytest.mark.thorough
def test_journey(options: list[str], tmp_path: Path, bundle: Bundle, scene_file: Path) -> None:
    log = tmp_path / "log"
    with daemon(log, "--port", "0", *options) as (process, url), Camera(url) as camera:
        status = camera.status()
        assert status.state == "ready"
        assert status.device.simulated

        # Light, not luck: another scene is another embedding, the same scene nearly the same.
        image = np.zeros((28, 28), np.uint8)
        image[:10, :10] = 255
        write_scene(scene_file, image)
        first, second = np.asarray(camera.capture()), np.asarray(camera.capture())
        write_scene(scene_file, image[::-1].copy())
        other = np.asarray(camera.capture())
        repeated = np.linalg.norm(first - second) / np.linalg.norm(first)
        assert repeated < 0.1 < np.linalg.norm(first - other) / np.linalg.norm(first)

        # Every capture under its own mask, and the events tell of them in order.
        start = next(iter(camera.events(last_event_id="")))
        camera.rotation.set(EveryCaptures(captures=1))
        results = [camera.classify() for _ in range(4)]
        assert len({result.epoch for result in results}) == 4
        heard: dict[str, list[str]] = {"classification": [], "mask": []}
        for event in camera.events(last_event_id=start.id):
            if isinstance(event, Classified | MaskChanged):
                name = event.capture if isinstance(event, Classified) else event.epoch
                heard[event.kind].append(name)
            if len(heard["classification"]) == 4:
                break
        assert heard["classification"] == [result.id[:16] for result in results]
        assert {result.epoch for result in results[1:]} <= set(heard["mask"])

        # The async camera sees the same.
        async def ask() -> tuple[str, str]:
            async with AsyncCamera(url) as other:
                result = await other.classify()
                async for event in other.events(last_event_id=start.id):
                    if isinstance(event, Classified) and event.capture == result.id[:16]:
                        return result.label, event.label
            raise AssertionError("the event did not come")

        label, told = asyncio.run(ask())
        assert label == told

        # A scene that disappears is a problem; the daemon goes on when it is back.
        moved = scene_file.rename(tmp_path / "gone.npy")
        with Camera(url, max_retries=0) as impatient, pytest.raises(DeviceError) as caught:
            impatient.capture()
        assert caught.value.code == "sensor_failed"
        moved.rename(scene_file)
        camera.capture()

        # Another daemon on the same port, or on the same state, does not start.
        port = url.rpartition(":")[2]
        for more, reason in (
            (["--port", port, "--state-dir", str(tmp_path / "s2")], f"port {port} is occupied"),
            (["--port", "0"], "another veilcamd uses"),
        ):
            result = runner.invoke(app, ["serve", "--simulate", *options, *more])
            assert result.exit_code == 1
            assert reason in result.stderr
            assert result.stderr.count("veilcamd: error:") == 1
        camera.classify()

        process.send_signal(signal.SIGTERM)
        assert process.wait(300) == 0
        with pytest.raises(VeilcamError):
            Camera(url, max_retries=0).status()
    assert '"state": "stopping"' in log.read_text()
    _check_no_secrets(log.read_bytes(), bundle)


def _check_no_secrets(text: bytes, bundle: Bundle) -> None:
    """No four neighbouring levels of any mask stand in ``text`` as a list of numbers."""
    numbers = re.sub(rb"[^0-9]+", b" ", text)
    for pair in bundle.pairs:
        for row in pair.levels:
            for start in range(len(row) - 3):
                run = " ".join(str(level) for level in row[start : start + 4])
                assert f" {run} ".encode() not in numbers


@pytest.mark.thorough
def test_unix_socket(options: list[str], tmp_path: Path) -> None:
    path = tmp_path / "v.sock"
    left_behind = socket.socket(socket.AF_UNIX)
    left_behind.bind(str(path))
    left_behind.close()
    with daemon(tmp_path / "log", "--socket", str(path), *options) as (process, url):
        assert url == f"unix://{path}"
        assert path.stat().st_mode & 0o777 == 0o600
        with Camera(url) as camera:
            assert camera.classify().label in "0123456789"
        result = runner.invoke(client_cli, ["events", "--url", url, "--since", "", "--count", "2"])
        assert result.exit_code == 0
        assert len(result.stdout.splitlines()) == 2
        process.send_signal(signal.SIGTERM)
        assert process.wait(300) == 0
    assert not path.exists()


@pytest.mark.thorough
def test_sockets_and_states_of_systemd(options: list[str], tmp_path: Path) -> None:
    path = tmp_path / "api.sock"
    serve = [sys.executable, "-m", "veilcam_server", "serve", "--simulate", *options]
    with (
        socket.create_server(("127.0.0.1", 0)) as tcp,
        socket.socket(socket.AF_UNIX) as unix,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd,
        (tmp_path / "log").open("w") as log,
    ):
        unix.bind(str(path))
        unix.listen()
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(60)
        # From 3 on, and for the process that LISTEN_PID names.
        shell = f'LISTEN_PID=$$ exec "$@" 3<&{tcp.fileno()} 4<&{unix.fileno()}'
        process = subprocess.Popen(
            ["bash", "-c", shell, "serve", *serve, "--port", "1"],
            pass_fds=[tcp.fileno(), unix.fileno()],
            env={**os.environ, "LISTEN_FDS": "2", "NOTIFY_SOCKET": str(tmp_path / "notify")},
            stderr=log,
        )
        try:
            assert systemd.recv(100) == b"STATUS=ready", (tmp_path / "log").read_text()
            assert systemd.recv(100) == b"READY=1"
            for url in (f"http://127.0.0.1:{tcp.getsockname()[1]}", f"unix://{path}"):
                with Camera(url) as camera:
                    assert camera.status().state == "ready"
            process.send_signal(signal.SIGTERM)
            while (told := systemd.recv(100)) != b"STOPPING=1":
                assert told == b"STATUS=stopping: the daemon is stopping"
            assert process.wait(300) == 0
        finally:
            process.kill()
            process.wait()
    assert path.exists()  # systemd goes on listening there


@pytest.mark.thorough
def test_journey_through_fresh_masks(fresh_file: Path, scene_file: Path, tmp_path: Path) -> None:
    """No secret and no receiver; then a receiver, and an end that nobody was told of."""
    log, state = tmp_path / "log", tmp_path / "state"
    options = [
        *("--bundle", str(fresh_file), "--scenes", str(scene_file), "--port", "0"),
        *("--state-dir", str(state), "--settle", "0.01", "--exposure", "0"),
    ]
    key, epochs = ReceiverKey.generate(), list[str]()
    with daemon(log, *options) as (process, url), Camera(url) as camera:
        status = camera.status()
        assert (status.bundle.mode, status.release, status.receivers) == ("fresh", "none", ())
        assert status.rotation.policy == EveryCaptures(captures=1)
        epochs += [camera.classify().epoch for _ in range(3)]
        paired = camera.receivers.add("archive", key.public)
        assert camera.status().receivers == (paired,)
        # The mask shown now may be one from before; the second is none.
        forms = [camera.capture().embedding.form for _ in range(2)]
        assert forms[1] == "sealed"
        camera.rotation.set(EverySeconds(seconds=50, jitter=10))
        process.kill()
    device = status.device.key
    with daemon(log, *options) as (process, url), Camera(url, key=key, device=device) as camera:
        status = camera.status()
        assert (status.release, status.receivers, status.device.key) == (
            "sealed",
            (paired,),
            device,
        )
        # What was set over the API holds after a restart.
        assert status.rotation.policy == EverySeconds(seconds=50, jitter=10)
        for number in range(3):
            captured = camera.capture()
            assert (captured.number, captured.notes is None) == (number, False)
            assert np.asarray(captured).shape == status.bundle.embedding_shape
        assert captured.epoch not in epochs
        stranger = Camera(url, key=ReceiverKey.generate())
        with stranger, pytest.raises(SealedError, match="not sealed to receiver"):
            stranger.capture()
        process.kill()


@pytest.mark.thorough
def test_daemon_looks_by_itself_and_stays_off_when_switched_off(
    options: list[str], tmp_path: Path
) -> None:
    """Over a kill, too; and no panel was open for a self test meanwhile."""
    log, watching = tmp_path / "log", (*options, "--port", "0", "--watch", "5/s")
    with daemon(log, *watching) as (process, url), Camera(url) as camera:
        while camera.watch.get().looks < 3:
            time.sleep(0.1)
        assert camera.watch.get().activity == "looking"
        assert camera.status().captures == 0
        assert camera.watch.set(WatchOff()).activity == "off"
        looks = camera.watch.get().looks
        process.kill()
    with daemon(log, *watching) as (process, url), Camera(url) as camera:
        status, found = camera.status(), camera.watch.get()
        assert (status.state, status.rotation.preparation.prepared) == ("off", 0)
        assert (found.policy, found.activity, found.looks) == (WatchOff(), "off", 0)
        assert looks >= 3
        assert [past.state for past in camera.diagnostics().states] == ["off"]
        with pytest.raises(VeilcamError, match="switched off"):
            camera.classify()
        camera.watch.set(Watching(rate_hz=5.0))
        while camera.watch.get().looks < 1:
            time.sleep(0.1)
        process.send_signal(signal.SIGTERM)
        assert process.wait(300) == 0
